// The live page: shows what the server sends (see game.py), and sends what the person does.
(() => {
  const { $, make, write } = Dom;
  const VERDICTS = { won: "You won", lost: "You lost", drawn: "A draw", over: "The episode is over" };
  const SHOW = { lines: false, zone: true, ids: true, health: true, bags: true, trails: false, blind: false };
  const MODIFIERS = new Set(["Shift", "Control", "Alt", "AltGraph", "Meta", "CapsLock", "Tab", "Escape"]);
  const HINTS = [[["V"], "what the agent sees, or all"], [["P"], "pause"], [["R"], "next episode"]];
  const TURNED_AWAY = 1013; // see game.py

  const socket = new WebSocket(new URL("live", location.href.replace(/^http/, "ws")));
  const viewport = Viewport.build($("stage"), repaint);
  let world = null, state = null, sightOnly = true, waiting = false;

  // ---- the picture

  function paint() {
    waiting = false;
    if (!world || !state) return;
    const me = state.snapshot.agents[world.agent], out = !me.alive && !world.comes_back; // for good: it may see all
    const blind = sightOnly && !out && me.sees !== null;
    const show = { ...SHOW, cones: !blind, night: blind };
    const snapshot = blind ? Visible.to(world.agent, world, state.snapshot) : state.snapshot;
    viewport.draw(world, snapshot, { show, follow: world.agent, marks: marks(blind) });
  }

  // What happened a moment ago; to others only as far as they are seen.
  function marks(blind) {
    const { agents, tick } = state.snapshot, me = agents[world.agent];
    const age = (event) => (tick - event.tick) * world.seconds / Bodies.FADE;
    return state.events
      .filter((event) => age(event) < 1 && event.agent >= 0 && event.kind !== "other" && (!blind ||
        event.agent === world.agent || event.by === world.agent || me.sees.includes(event.agent)))
      .map((event) => ({ ...event, x: agents[event.agent].x, y: agents[event.agent].y, age: age(event) }));
  }

  function repaint() {
    if (!waiting) requestAnimationFrame(paint);
    waiting = true;
  }

  function setSight(only) {
    sightOnly = only;
    $("view").setAttribute("aria-pressed", String(only));
    repaint();
  }

  // ---- text

  function showObservation() {
    const list = $("words"), headings = Object.keys(state.text);
    if ([...list.querySelectorAll("dt")].map((dt) => dt.textContent).join() !== headings.join()) {
      list.replaceChildren();
      for (const heading of headings) {
        make("dt", "", list, heading);
        make("dd", "", list).dataset.heading = heading;
      }
    }
    for (const dd of list.querySelectorAll("dd")) write(dd, state.text[dd.dataset.heading].join("\n"));
    const health = list.querySelector("[data-heading=Health]"), whole = world.agents[world.agent].health;
    if (health && whole) health.classList.toggle("dying", Bodies.healthColor(state.snapshot.agents[world.agent].health / whole) === "dying");
  }

  function showClock() {
    const { tick, episode } = state.snapshot;
    $("tick").textContent = tick;
    $("clock").title = Dom.seconds(tick, world);
    $("title").textContent = `${world.name}, episode ${episode}`;
    $("pause").firstChild.data = state.phase === "paused" ? "Go on" : "Pause";
    $("pause").disabled = !["running", "paused"].includes(state.phase);
    $("pace").value = String(state.speed);
  }

  // What stands over the picture: title, lines, whether it offers the next episode; null: nothing.
  function card() {
    const touched = matchMedia("(pointer: coarse)").matches;
    if (state.phase === "ready") return [`${state.steers ? "You are" : "The other page is"} agent ${world.agent}${called()}`, [...about(), begins(touched)]];
    if (state.phase === "paused") return ["Paused", !state.steers ? [] : [touched ? "Go on with the button below." : "P goes on, R begins the next episode."]];
    if (state.phase !== "over") return null;
    const { verdict, kills, length, truncated, return: sum } = state.result;
    const lines = [`${length} ticks (${Dom.seconds(length, world)})${kills === null ? "" : `, ${kills} ${kills === 1 ? "kill" : "kills"}`}` +
      `${world.teams ? " of your team" : ""}, return ${sum ?? "not a finite number"}`];
    if (truncated) lines.unshift("Time is up.");
    if (state.death) lines.push(death());
    return [VERDICTS[verdict], lines];
  }

  const begins = (touched) => (!state.steers ? "It has not begun." : touched ? "Touch the stick to begin." : "Press a key to begin.");

  // Which role the person has, unless there are none.
  const called = () => world.agents[world.agent].role && `, ${world.agents[world.agent].role}`;

  // What the game is about, and who plays with whom.
  function about() {
    const { agents, agent, about: text } = world, mine = agents[agent].side;
    const [friends, enemies] = [true, false].map((same) => agents.map((_, i) => i).filter((i) => i !== agent && agents[i].side >= 0 && (agents[i].side === mine) === same));
    const lines = text ? [`${world.name}: ${text}.`] : [];
    if (friends.length) lines.push(`With you: ${named(friends)}.`);
    if (enemies.length) lines.push(`Against you: ${named(enemies)}.`);
    return [...lines, "The first seconds run at half speed."];
  }

  const named = (agents) => (agents.length > 8 ? `${agents.length} agents` : `agent${agents.length > 1 ? "s" : ""} ${agents.join(", ")}`);

  function death() {
    const { kind, cause, by, side, tick } = state.death, killer = by >= 0 ? `Agent ${by}` : `Side ${side}`;
    const what = kind === "kill" ? `${killer} killed you` : "You died";
    return `${what}${cause && ` (${cause})`} after ${Dom.seconds(tick, world)}.`;
  }

  function showCard() {
    const [title, lines] = card() || ["", []];
    $("card").hidden = !title;
    $("card").dataset.phase = state.phase;
    const [heading, text, keys, begin, next] = $("card").children;
    heading.textContent = title;
    text.textContent = lines.join("\n");
    keys.hidden = state.phase !== "ready" || !state.steers;
    begin.hidden = state.phase !== "ready" || !state.steers;
    next.hidden = state.phase !== "over" || !state.steers;
    const badge = !state.steers ? "Another page steers; you watch." : state.phase !== "running" ? "" :
      state.death ? `${death()} The others play on.` : state.slow ? "Slow start: half speed." : "";
    $("badge").hidden = !badge;
    $("badge").textContent = badge;
    document.body.classList.toggle("watching", !state.steers);
  }

  // ---- the server

  const send = (message) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(message));
  const command = (name) => send({ command: name });
  const steer = (held, tapped) => state && state.steers && send({ held, tapped });

  function enter(description) {
    world = description;
    Keys.releaseAll();
    Keys.bind(world.actions, steer);
    explain();
    Keys.learn().then(explain);
    Keys.buttons($("buttons"));
    document.title = `outlast: ${world.name}`;
  }

  const explain = () => document.querySelectorAll(".keys").forEach((list) => Keys.explain(list, HINTS));

  socket.addEventListener("message", ({ data }) => {
    const message = JSON.parse(data);
    if (message.world) return enter(message.world);
    state = message;
    showObservation();
    showClock();
    showCard();
    repaint();
  });
  socket.addEventListener("close", ({ code, reason }) => {
    $("badge").hidden = false;
    $("badge").textContent = code === TURNED_AWAY ? `There is no place for this page: ${reason}. Close one of them, and reload.` :
      `The game is over: ${reason || "the server is gone"}. Start outlast play again.`;
    document.body.classList.add("gone");
  });

  // ---- the person

  const actions = { // by the letter on the key; in other scripts, by that of a QWERTY keyboard
    v: () => setSight(!sightOnly),
    r: () => command("restart"),
    p: () => command(state && state.phase === "paused" ? "resume" : "pause"),
  };
  const letter = ({ key, code }) => (/^[a-z]$/i.test(key) ? key : code.replace("Key", "")).toLowerCase();

  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const pressing = event.code === "Space" && event.target.tagName === "BUTTON" && state && state.phase !== "running";
    if (pressing) return; // while the world runs, the space bar strikes, whatever has the focus
    if (Keys.keydown(event)) event.preventDefault(); // the page must not scroll, nor a button be pressed
    else if (event.repeat || MODIFIERS.has(event.key)) return;
    else if (actions[letter(event)]) actions[letter(event)]();
    else if (state && state.phase === "ready" && event.target.tagName !== "BUTTON") command("begin");
  });
  addEventListener("keyup", (event) => {
    if (Keys.keyup(event)) event.preventDefault();
  });
  addEventListener("blur", () => Keys.releaseAll());
  document.addEventListener("visibilitychange", () => document.hidden && command("pause"));
  addEventListener("resize", repaint);

  const press = (button, action) => button.addEventListener("click", () => { action(); button.blur(); });
  document.querySelectorAll("[data-command]").forEach((button) => press(button, () => command(button.dataset.command)));
  press($("pause"), actions.p);
  press($("view"), actions.v);
  $("pace").append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed)));
  $("pace").addEventListener("change", ({ target }) => { send({ speed: Number(target.value) }); target.blur(); });
  Keys.stick($("stick"));
  setSight(true);
})();
