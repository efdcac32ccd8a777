// Controls: keys, buttons and selectors of a player.
const Controls = (() => {
  const KEYS = [
    ["space", "play or pause"], ["← →", "a tick back or forward; with shift a second"],
    ["P N", "to the event before or after"], ["Home End", "to the start or the end"], ["[ ]", "episode before or after"],
    ["− +", "slower or faster"], ["0 – 9", "follow an agent, or let it go"],
  ];
  const { $ } = Dom;

  function build(player) {
    const { state, rooms, views, seek, step, jump, faster, follow, choose, link, swap, episode, linked } = player;
    const toggle = () => (state.playing ? player.pause() : player.play());
    const second = () => Math.round(1 / episode().description.seconds);
    const actions = {
      " ": toggle, "k": toggle,
      "ArrowLeft": (event) => step(event.shiftKey ? -second() : -1),
      "ArrowRight": (event) => step(event.shiftKey ? second() : 1),
      "Home": () => seek(0), "End": () => seek(Infinity), "n": () => jump(1), "p": () => jump(-1),
      "[": () => choose(state.world, state.episode - 1), "]": () => choose(state.world, state.episode + 1),
      "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1), "_": () => faster(-1),
      "Escape": () => follow(-1), "?": () => $("keys").showModal(),
      ...(linked ? { "u": link } : {}), ...(rooms.length > 1 ? { "o": swap } : {}),
    };

    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open || event.target.matches("select")) return;
      if (event.key === " " && event.target.matches("button")) return; // it presses the button
      const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
      if (key in actions) actions[key](event);
      else if (key in views.byKey) views.toggle(views.byKey[key]);
      else if (key >= "0" && key <= "9") follow(Number(key));
      else return;
      event.preventDefault();
    });

    // A pointer leaves no focus behind on buttons: the next space is meant to play.
    document.addEventListener("click", (event) => {
      if (event.detail && event.target.closest("button")) document.activeElement.blur();
    });

    for (const [id, action] of [["play", toggle], ["first", () => seek(0)], ["back", () => step(-1)], ["forward", () => step(1)],
      ["next", () => jump(1)], ["slower", () => faster(-1)], ["faster", () => faster(1)], ["help", actions["?"]], ["link", link]]) {
      $(id).addEventListener("click", action);
    }
    for (const room of rooms) {
      room.canvas.addEventListener("click", ({ clientX, clientY }) => {
        follow(room.viewport.agentAt(room.episode.description, room.exact(state.at), clientX, clientY));
      });
    }
    $("world").addEventListener("change", ({ target }) => choose(Number(target.value), 0));
    $("episode").addEventListener("change", ({ target }) => choose(state.world, Number(target.value)));
    $("link").hidden = !linked;
    const others = [...(linked ? [["U", "copy the link to this tick"]] : []), ...(rooms.length > 1 ? [["O", "list the other recording"]] : [])];
    Views.explain($("keys"), [...KEYS, ...others, ["?", "this list"]]);
  }

  return { build };
})();
