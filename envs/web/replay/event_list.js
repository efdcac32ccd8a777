// EventList: the events of an episode, each a button that leads there.
const EventList = (() => {
  // onSeek(k) is called with the row of an event. Returns {show(episode), mark(k)}.
  function build(root, onSeek) {
    let buttons = [], events = [], marked = -1;

    function show(episode) {
      const { description, start } = episode;
      events = episode.events;
      marked = -1;
      root.replaceChildren();
      buttons = events.map((event) => {
        const button = Dom.make("button", "later", Dom.make("li", "", root));
        Object.assign(button.dataset, { at: event.at, kind: event.kind });
        Dom.make("time", "", button, start + event.at);
        Events.append(button, event, description);
        button.addEventListener("click", () => onSeek(event.at));
        return button;
      });
    }

    // What has happened until row k stands out, its last one most.
    function mark(k) {
      const now = events.findLastIndex(({ at }) => at <= k);
      if (now === marked) return;
      const [from, to] = [Math.min(now, marked) + 1, Math.max(now, marked)];
      buttons.slice(from, to + 1).forEach((button) => button.classList.toggle("later", now < marked));
      if (marked >= 0) buttons[marked].removeAttribute("aria-current");
      marked = now;
      if (now < 0) return;
      buttons[now].setAttribute("aria-current", "true");
      root.scrollTop = buttons[now].offsetTop - root.offsetTop - root.clientHeight / 2;
    }

    return { show, mark };
  }

  return { build };
})();
