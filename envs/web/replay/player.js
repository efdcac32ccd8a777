// Player.start(recording): goes through a recording in time. State is where it is; everything on the page is drawn from that.
const Player = { start: async (base64) => {
  const SPEEDS = [1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8, 16, 32];
  const KEYS = [
    ["space", "play or pause"], ["← →", "a tick back or forward; with shift a second"],
    ["P N", "to the event before or after"], ["Home End", "to the start or the end"], ["[ ]", "episode before or after"],
    ["− +", "slower or faster"], ["0 – 9", "follow an agent, or let it go"], ["?", "this list"],
  ];
  const FRACTIONS = { 0.125: "⅛", 0.25: "¼", 0.5: "½" };
  const { $ } = Dom;
  const state = { world: 0, episode: 0, at: 0, playing: false, speed: 3, follow: -1 };

  let recording = await Recording.open(base64);
  const viewport = Viewport.build($("stage"), () => { timeline.show(episode(), Viewport.theme()); redraw(); });
  const views = Views.build($("views"), () => redraw());
  const tip = $("tip");
  tip.show = (event, x, y) => {
    Dom.write(tip, `${episode().start + event.at}: ${Events.text(event, episode().description)}`);
    const half = tip.offsetWidth / 2;
    tip.style.left = `${Math.min(Math.max(x, half), tip.parentElement.clientWidth - half)}px`;
    tip.style.top = `${y}px`;
  };
  const timeline = Timeline.build($("timeline"), tip, (k) => seek(k));
  const eventList = EventList.build($("events"), (k) => seek(k));
  let updateCards = null, waiting = 0, before = 0, rest = 0;

  const world = () => recording.worlds[state.world];
  const episode = () => world().episodes[state.episode];
  const row = () => Math.floor(state.at);

  // ---- where we are

  function choose(w, e, at = 0) {
    episode().forget();
    Object.assign(state, { world: w, episode: Math.min(Math.max(e, 0), recording.worlds[w].episodes.length - 1) });
    state.at = Math.min(Math.max(at, 0), episode().length - 1);
    const { description } = episode();
    if (state.follow >= description.agents.length) state.follow = -1;
    updateCards = Panel.build($("cards"), description, follow);
    count(description);
    eventList.show(episode());
    selectors();
    timeline.show(episode(), Viewport.theme());
    redraw();
  }

  function seek(k) {
    state.at = Math.min(Math.max(k, 0), episode().length - 1);
    rest = 0;
    redraw();
  }

  function step(ticks) {
    pause();
    const k = row() + ticks;
    if (k >= episode().length && state.episode + 1 < world().episodes.length) choose(state.world, state.episode + 1);
    else if (k < 0 && state.episode > 0) choose(state.world, state.episode - 1, Infinity);
    else seek(k);
  }

  function jump(way) {
    const places = episode().events.map(({ at }) => at);
    const next = way > 0 ? places.find((at) => at > row()) : places.findLast((at) => at < row());
    if (next !== undefined) seek(next);
  }

  function follow(i) {
    state.follow = i < 0 || i === state.follow || i >= episode().description.agents.length ? -1 : i;
    redraw();
  }

  // ---- time

  const last = () => state.episode + 1 === world().episodes.length;

  function play() {
    if (state.at >= episode().length - 1 && last()) state.at = 0;
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
    const seconds = Math.min(0.25, (now - before) / 1000), end = episode().length - 1;
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
    const shown = episode(), k = row(), { description } = shown, exact = shown.snapshot(k);
    const share = Viewport.still() ? 0 : state.at - k, moved = share && k + 1 < shown.length;
    const snapshot = moved ? Recording.blend(exact, shown.snapshot(k + 1), share) : exact;
    const view = { show: views.show, close: views.show.close, follow: state.follow, marks: Events.marks(shown, state.at) };
    if (views.show.trails) view.trails = Events.trails(shown, k);
    const moving = viewport.draw(description, snapshot, view);
    timeline.draw(state.at);
    views.fit(description, state.follow);
    updateCards(exact, state.follow, Events.tallies(shown, k));
    facts(exact, description);
    eventList.mark(k);
    if (state.playing || moving) redraw();
  }

  function facts({ tick, agents, objects, zone }, description) {
    Dom.write($("tick"), tick);
    Dom.write($("length"), episode().start + episode().length - 1);
    Dom.write($("seconds"), Dom.seconds(tick, description));
    Dom.write($("speed"), `${FRACTIONS[SPEEDS[state.speed]] || SPEEDS[state.speed]}×`);
    $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
    Dom.write($("alive"), agents.filter(({ alive }) => alive).length);
    Dom.write($("agents"), agents.length);
    Dom.write($("zone"), zone ? zone[2].toFixed(1) : "–");
    for (const fact of $("facts").querySelectorAll("[data-role]")) {
      Dom.write(fact, objects.filter(({ here }, j) => here && description.objects[j].role === fact.dataset.role).length);
    }
    $("timeline").setAttribute("aria-valuenow", tick);
    $("timeline").setAttribute("aria-valuetext", `tick ${tick}`);
  }

  // Objects in the world by kind, as far as this scenario has them.
  function count({ objects, zone }) {
    const roles = [["heal", "Heals"], ["box", "Boxes"], ["box_item", "Broken"], ["item", "Items"]];
    $("facts").querySelectorAll("[data-role]").forEach((fact) => fact.closest("div").remove());
    for (const [role, name] of roles.filter(([role]) => objects.some((object) => object.role === role))) {
      const fact = Dom.make("div", "", $("facts"));
      Dom.make("dt", "", fact, name);
      Dom.make("b", "", Dom.make("dd", "", fact)).dataset.role = role;
    }
    $("zone").closest("div").hidden = !zone;
  }

  // ---- choosing a world and an episode

  function selectors() {
    options($("world"), recording.worlds.map(({ world }) => `World ${world}`), state.world);
    options($("episode"), world().episodes.map(({ number }) => `Episode ${number}`), state.episode);
    const many = world().episodes.length > 1;
    $("episodes").hidden = !many;
    $("episodes").replaceChildren();
    world().episodes.forEach(({ length, number }, e) => {
      const button = Dom.make("button", "", $("episodes"));
      button.style.flexGrow = length;
      button.title = `Episode ${number}, ${length - 1} ticks`;
      button.setAttribute("aria-label", button.title);
      button.setAttribute("aria-current", e === state.episode);
      button.addEventListener("click", () => choose(state.world, e));
    });
    $("timeline").setAttribute("aria-valuemin", episode().start);
    $("timeline").setAttribute("aria-valuemax", episode().start + episode().length - 1);
  }

  function options(select, names, chosen) {
    select.replaceChildren(...names.map((name, value) => new Option(name, value)));
    select.value = chosen;
    select.hidden = names.length < 2;
  }

  // ---- keys and buttons

  const toggle = () => state.playing ? pause() : play();
  const second = () => Math.round(1 / episode().description.seconds);
  const actions = {
    " ": toggle, "k": toggle,
    "ArrowLeft": (event) => step(event.shiftKey ? -second() : -1),
    "ArrowRight": (event) => step(event.shiftKey ? second() : 1),
    "Home": () => seek(0), "End": () => seek(Infinity), "n": () => jump(1), "p": () => jump(-1),
    "[": () => choose(state.world, state.episode - 1), "]": () => choose(state.world, state.episode + 1),
    "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1), "_": () => faster(-1),
    "Escape": () => follow(-1), "?": () => $("keys").showModal(),
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
    ["next", () => jump(1)], ["slower", () => faster(-1)], ["faster", () => faster(1)], ["help", actions["?"]]]) {
    $(id).addEventListener("click", action);
  }
  $("stage").addEventListener("click", ({ clientX, clientY }) => {
    follow(viewport.agentAt(episode().description, episode().snapshot(row()), clientX, clientY));
  });
  $("world").addEventListener("change", ({ target }) => choose(Number(target.value), 0));
  $("episode").addEventListener("change", ({ target }) => choose(state.world, Number(target.value)));
  new ResizeObserver(() => { timeline.resize(); redraw(); }).observe(document.body);
  Views.explain($("keys"), KEYS);
  choose(0, 0);
  if (!Viewport.still()) play();

  // Another recording in place of this one; speed, views and the followed agent stay.
  async function load(base64) {
    recording = await Recording.open(base64);
    Object.assign(state, { world: 0, episode: 0 });
    choose(0, 0);
    play();
  }

  const atEnd = () => !state.playing && last() && row() === episode().length - 1;
  window.outlast = { state, seek, play, pause, follow, choose, load, atEnd };
  return window.outlast;
} };
