// Room: a recording of the page, with a canvas and a part of the timeline. Those side by side are in step by rows.
const Room = (() => {
  // The n-th of `count` rooms. on: {seek(k), focus(), theme()}. Canvases of the first one are in the page.
  function build(n, count, on) {
    const stage = part("stage", n), strips = part("timeline", n), tip = strips.querySelector(".tip");
    const canvas = stage.querySelector("canvas");
    const viewport = Viewport.build(canvas, on.theme);
    const caption = count > 1 ? Dom.make("button", "caption", stage) : null;
    const heading = count > 1 ? Dom.make("h3") : null;
    if (caption) caption.addEventListener("click", on.focus);
    if (heading) strips.prepend(heading);
    tip.show = (event, x, y) => {
      Dom.write(tip, `${room.episode.start + event.at}: ${Events.text(event, room.episode.description)}`);
      const half = tip.offsetWidth / 2;
      tip.style.left = `${Math.min(Math.max(x, half), tip.parentElement.clientWidth - half)}px`;
      tip.style.top = `${y + strips.querySelector("canvas").offsetTop}px`;
    };
    const room = {
      canvas, viewport, title: "", worlds: [], episode: null, missing: false,
      timeline: Timeline.build(strips.querySelector("canvas"), tip, on.seek),
      load({ title, worlds }) {
        Object.assign(room, { title, worlds, episode: worlds[0].episodes[0] });
        if (heading) Dom.write(heading, title);
      },
      choose(w, e) {
        const { episodes } = room.worlds[w];
        room.episode.forget();
        room.missing = e >= episodes.length;
        room.episode = episodes[Math.min(e, episodes.length - 1)];
        strips.hidden = room.missing; // it would be another episode's
      },
      shows: (at) => !room.missing && at < room.episode.length,
      // The row of this recording at a position of all: its last one from its end on.
      row: (at) => (room.missing ? room.episode.length - 1 : Math.min(Math.floor(at), room.episode.length - 1)),
      exact: (at) => room.episode.snapshot(room.row(at)),
      paint(at, show, follow, focused) {
        const { episode } = room, k = room.row(at), share = Viewport.still() ? 0 : at - k, moved = share > 0 && k + 1 < episode.length;
        const exact = episode.snapshot(k), snapshot = moved ? Recording.blend(exact, episode.snapshot(k + 1), share) : exact;
        const view = { show, close: show.close, follow, marks: Events.marks(episode, Math.min(at, k + 1)) };
        if (show.trails) view.trails = Events.trails(episode, k);
        if (show.attention && follow >= 0) view.attends = episode.thought(follow, k)?.attends;
        room.timeline.draw(Math.min(at, episode.length - 1), follow);
        if (caption) label(caption, room, at, focused);
        return viewport.draw(episode.description, snapshot, view);
      },
    };
    return room;
  }

  // The first of a kind of element, or a copy of it behind it.
  function part(name, n) {
    const first = document.querySelector(`.${name}`);
    if (!n) return first;
    const copy = first.cloneNode(true);
    for (const element of copy.querySelectorAll("[id]")) element.id += n;
    for (const element of copy.querySelectorAll(".caption, h3")) element.remove();
    first.after(copy);
    return copy;
  }

  function label(caption, { title, episode, missing, row }, at, focused) {
    const k = row(at), ended = missing || at >= episode.length;
    Dom.write(caption, `${title} · ${ended ? "ended at " : ""}tick ${episode.start + k}`);
    caption.setAttribute("aria-pressed", focused);
  }

  return { build };
})();
