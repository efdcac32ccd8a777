// A page of its own: plays the recording that is in it. In the frame of a notebook it has no address.
Player.start(Dom.$("data").textContent, { linked: location.protocol !== "about:" }).catch((error) => {
  document.body.textContent = `This recording cannot be played here: ${error.message}. A current browser is needed.`;
  throw error;
});
