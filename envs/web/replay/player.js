// Player.start(recordings): goes through them in time. State is where it is; everything on the page is drawn from that.
// linked: whether the address says what is shown, and leads there.
const Player = { start: async (base64, { linked = false } = {}) => {
  const SPEEDS = [1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16, 32];
  const FRACTIONS = { 0.125: "⅛", 0.25: "¼", 0.5: "½" };
  const EVERY = 1000; // milliseconds between changes of the address while it plays
  const MANY = 100; // episodes, whose buttons have no room between them
  const { $ } = Dom;
  const state = { world: 0, episode: 0, at: 0, playing: false, speed: 3, follow: -1, focus: 0 };

  const recordings = await Recording.open(base64);
  const rooms = recordings.map((_, n) => Room.build(n, recordings.length, {
    seek: (k) => seek(k), focus: () => focus(n), theme: () => { lines(); redraw(); },
  }));
  document.body.classList.toggle("beside", rooms.length > 1);
  const views = Views.build($("views"), () => redraw());
  const eventList = EventList.build($("events"), (k) => seek(k));
  const updateMind = Mind.build($("mind"));
  let updateCards = null, waiting = 0, before = 0, rest = 0, addressed = 0;

  const room = () => rooms[state.focus];
  const episode = () => room().episode;
  const row = () => Math.floor(state.at);
  const count = () => Math.max(...rooms.map(({ worlds }) => worlds[state.world].episodes.length));
  const ticks = () => Math.max(...rooms.map(({ episode, missing }) => (missing ? 0 : episode.length)));

  // ---- where we are

  function choose(w, e, at = 0) {
    state.world = w;
    state.episode = Math.min(Math.max(e, 0), count() - 1);
    for (const each of rooms) each.choose(w, state.episode);
    state.at = Math.min(Math.max(at, 0), ticks() - 1);
    if (!known(state.follow)) state.follow = -1;
    selectors();
    lines();
    focus(state.focus);
  }

  // Whether there is such an agent: where counts vary, some are absent.
  const known = (i) => rooms.some(({ episode }) => episode.description.agents[i]?.side >= 0);

  // The room whose agents and events are listed.
  function focus(n) {
    state.focus = n;
    updateCards = Panel.build($("cards"), episode().description, follow);
    Facts.build(episode().description);
    eventList.show(episode());
    redraw();
  }

  // Timelines, to one scale.
  function lines() {
    const paid = rooms.flatMap(({ episode }) => (episode.description.rewards ? episode.returns() : []));
    const [low, high] = paid.reduce(([low, high], values) => values.reduce(
      ([least, most], value) => (Number.isFinite(value) ? [Math.min(least, value), Math.max(most, value)] : [least, most]), [low, high]), [0, 0]);
    const scale = { ticks: ticks(), low, high, dense: rooms.length > 1 };
    for (const { timeline, episode } of rooms) timeline.show(episode, Viewport.theme(), scale);
  }

  function seek(k) {
    state.at = Math.min(Math.max(k, 0), ticks() - 1);
    rest = 0;
    redraw();
  }

  function step(steps) {
    pause();
    const k = row() + steps;
    if (k >= ticks() && !last()) choose(state.world, state.episode + 1);
    else if (k < 0 && state.episode > 0) choose(state.world, state.episode - 1, Infinity);
    else seek(k);
  }

  function jump(way) {
    const places = episode().events.map(({ at }) => at);
    const next = way > 0 ? places.find((at) => at > row()) : places.findLast((at) => at < row());
    if (next !== undefined) seek(next);
  }

  function follow(i) {
    state.follow = i === state.follow || !known(i) ? -1 : i;
    redraw();
  }

  // ---- time

  const last = () => state.episode + 1 === count();

  function play() {
    if (state.at >= ticks() - 1 && last()) state.at = 0;
    state.playing = true;
    before = performance.now();
    redraw();
  }

  function pause() {
    state.playing = false;
    state.at = row();
    redraw();
  }

  function faster(way) {
    state.speed = Math.min(Math.max(state.speed + way, 0), SPEEDS.length - 1);
    redraw();
  }

  function advance(now) {
    const seconds = Math.min(0.25, Math.max(0, now - before) / 1000), end = ticks() - 1;
    before = now;
    state.at = Math.min(end, state.at + seconds * SPEEDS[state.speed] / episode().description.seconds);
    if (state.at < end) return;
    rest += seconds;
    if (last()) {
      pause();
      document.dispatchEvent(new Event("ended"));
    } else if (rest > 1) [rest] = [0, choose(state.world, state.episode + 1)];
  }

  // ---- what is seen of it

  function redraw() {
    if (!waiting) waiting = requestAnimationFrame(paint);
  }

  function paint(now) {
    waiting = 0;
    if (state.playing) advance(now);
    const k = room().row(state.at), exact = room().exact(state.at);
    views.fit(rooms.map(({ episode }) => episode.description), state.follow);
    const moving = rooms.map((each, n) => each.paint(state.at, views.show, state.follow, n === state.focus)).some(Boolean);
    updateCards(exact, state.follow, Events.tallies(episode(), k));
    updateMind(episode(), state.follow, k);
    Facts.show(exact, episode());
    Dom.write($("speed"), `${FRACTIONS[SPEEDS[state.speed]] || SPEEDS[state.speed]}×`);
    $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    eventList.mark(k);
    if (linked && (!state.playing || now - addressed > EVERY)) [addressed] = [now, Address.write(place())];
    if (state.playing || moving) redraw();
  }

  // ---- choosing a world and an episode

  function selectors() {
    const { worlds } = rooms[0], longest = rooms.map(({ worlds }) => worlds[state.world].episodes)
      .reduce((most, episodes) => (episodes.length > most.length ? episodes : most));
    options($("world"), worlds.map(({ world }) => `World ${world}`), state.world);
    options($("episode"), longest.map(({ number }) => `Episode ${number}`), state.episode);
    $("episodes").hidden = longest.length < 2;
    $("episodes").classList.toggle("many", longest.length > MANY);
    $("episodes").replaceChildren();
    longest.forEach(({ length, number }, e) => {
      const button = Dom.make("button", "", $("episodes"));
      button.style.flexGrow = length;
      button.title = `Episode ${number}, ${length - 1} ticks`;
      button.setAttribute("aria-label", button.title);
      button.setAttribute("aria-current", e === state.episode);
      button.addEventListener("click", () => choose(state.world, e));
    });
  }

  function options(select, names, chosen) {
    select.replaceChildren(...names.map((name, value) => new Option(name, value)));
    select.value = chosen;
    select.hidden = names.length < 2;
  }

  // ---- the address of what is shown

  // In a room that goes on: the one whose agents are listed, if it does.
  function place() {
    const on = room().shows(state.at) ? room() : rooms.find((each) => each.shows(state.at)), beside = rooms.indexOf(on);
    const { world } = on.worlds[state.world], { number, start } = on.episode;
    const agent = state.follow < 0 ? {} : { agent: state.follow };
    return { tick: start + on.row(state.at), world, episode: number, ...agent, ...(beside ? { beside } : {}) };
  }

  function go(address) {
    const n = address.beside ?? 0, { w, e, at, missing } = Address.find(rooms[n] ?? rooms[0], address);
    pause();
    choose(w, e, at);
    if (rooms[n]) focus(n);
    state.follow = known(address.agent) ? address.agent : -1;
    const who = address.agent === undefined || known(address.agent) ? "" : `agent ${address.agent}`;
    const absent = [rooms[n] ? "" : `recording ${n}`, missing, who].filter(Boolean).join(", ");
    Dom.say(absent && `This page does not have ${absent}.`);
  }

  async function link() {
    const copied = await Address.copy(place());
    Dom.say(copied ? "The link to this tick is copied." : "This browser copies nothing here: the address bar has the link.");
  }

  // Another recording in place of this one; speed, views and the followed agent stay. on: whether it is the same with
  // more ticks, in which it goes on where it is, and plays unless it was paused.
  async function load(base64, on = false) {
    const others = await Recording.open(base64), plays = !on || state.playing || (atEnd() && !Viewport.still());
    rooms.forEach((each, n) => each.load(others[n]));
    choose(0, 0, on ? state.at : 0);
    if (plays) play();
  }

  const atEnd = () => !state.playing && last() && row() === ticks() - 1;
  const swap = () => focus((state.focus + 1) % rooms.length);
  window.outlast = { state, rooms, seek, play, pause, follow, choose, load, atEnd };
  rooms.forEach((each, n) => each.load(recordings[n]));
  Controls.build({ ...window.outlast, views, linked, step, jump, faster, link, swap, episode });
  new ResizeObserver(() => { for (const { timeline } of rooms) timeline.resize(); redraw(); }).observe(document.body);
  choose(0, 0);
  const address = linked && Address.read();
  if (address) go(address);
  else if (!Viewport.still()) play();
  if (linked) window.addEventListener("hashchange", () => { if (Address.read()) go(Address.read()); });
  return window.outlast;
} };
