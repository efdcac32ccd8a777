// A page of its own: plays the recording that is in it.
Player.start(Dom.$("data").textContent, { linked: true }).catch((error) => {
  document.body.textContent = `This recording cannot be played here: ${error.message}. A current browser is needed.`;
  throw error;
});
