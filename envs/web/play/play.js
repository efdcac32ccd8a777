"use strict";
// The live page: shows what the server tells (see session.py), and tells it what the person does.
(() => {
  const $ = (id) => document.getElementById(id);
  const SPEEDS = [0.25, 0.5, 1, 2, 4];
  const VERDICTS = { won: "You won", lost: "You lost", drawn: "A draw", over: "The episode is over" };
  const SHOW = { lines: false, zone: true, ids: true, health: true, bags: true, trails: false, blind: false };
  const HINTS = [["V", "what the agent sees, or all"], ["P", "pause"], ["R", "next episode"]];

  const canvas = $("stage"), context = canvas.getContext("2d");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const socket = new WebSocket(new URL("live", location.href.replace(/^http/, "ws")));
  let world = null, state = null, seeing = true, waiting = false;

  // ---- the picture

  const theme = () => (dark.matches ? "dark" : "light");

  function dress() {
    for (const [name, color] of Object.entries(COLORS[theme()])) document.documentElement.style.setProperty(`--${name}`, color);
    document.documentElement.style.setProperty("--focus", COLORS[theme()].ink);
    repaint();
  }

  function paint() {
    waiting = false;
    if (!world || !state) return;
    const { width, height } = canvas.getBoundingClientRect(), ratio = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const me = state.snapshot.agents[world.agent], blind = seeing && me.alive && me.sees !== null;
    const options = {
      width, height, ratio, show: { ...SHOW, cones: !blind }, follow: world.agent, trails: [], marks: marks(blind),
      colors: COLORS[theme()], camera: { x: 0, y: 0, half: world.half },
    };
    World.draw(context, world, blind ? Sight.of(world, state.snapshot, world.agent) : state.snapshot, options);
    if (blind) Sight.dim(context, world, me, options);
    canvas.dataset.tick = state.snapshot.tick;
  }

  // What happened within the last second; to others only as far as they are seen.
  function marks(blind) {
    const { agents, tick } = state.snapshot, me = agents[world.agent];
    const words = ({ kind, agent, thing }) => kind === "heal" ? `+${world.things[thing].amount}` :
      kind === "kill" || kind === "death" ? `${agent} died` : "";
    return state.events
      .map((event) => ({ ...event, age: (tick - event.tick) * world.seconds }))
      .filter(({ agent, by, age }) => age < 1 && agent >= 0 &&
        (!blind || agent === world.agent || by === world.agent || me.sees.includes(agent)))
      .map((event) => ({ ...agents[event.agent], kind: event.kind, age: event.age, words: words(event) }));
  }

  function repaint() {
    if (!waiting) requestAnimationFrame(paint);
    waiting = true;
  }

  function look(only) {
    seeing = only;
    $("view").setAttribute("aria-pressed", String(only));
    repaint();
  }

  // ---- words

  function tellWords() {
    const entries = Object.entries(state.words);
    const list = $("words");
    if ([...list.children].filter(({ tagName }) => tagName === "DT").map((dt) => dt.textContent).join() !==
        entries.map(([heading]) => heading).join()) {
      list.replaceChildren(...entries.flatMap(([heading]) => {
        const dt = document.createElement("dt"), dd = document.createElement("dd");
        dt.textContent = dd.dataset.heading = heading;
        return [dt, dd];
      }));
    }
    for (const dd of list.querySelectorAll("dd")) {
      const text = state.words[dd.dataset.heading].join("\n");
      if (dd.textContent !== text) dd.textContent = text;
    }
    const me = state.snapshot.agents[world.agent];
    list.querySelector("[data-heading=Health]").classList.toggle("dying", me.health <= world.health / 4);
  }

  function tellClock() {
    const { tick, episode } = state.snapshot;
    $("tick").textContent = tick;
    $("clock").title = `${(tick * world.seconds).toFixed(1)} s`;
    $("title").textContent = `${world.name}, episode ${episode}`;
    $("pause").firstChild.data = state.phase === "paused" ? "Go on" : "Pause";
    $("pause").disabled = !["running", "paused"].includes(state.phase);
    $("pace").value = String(state.speed);
  }

  // What stands over the picture: title, lines, whether it offers the next episode; null: nothing.
  function card() {
    if (state.phase === "ready") return [`You are agent ${world.agent}`, [matchMedia("(pointer: coarse)").matches ? "Touch the stick to begin." : "Press a key to begin."], false];
    if (state.phase === "paused") return ["Paused", ["P goes on."], false];
    if (state.phase !== "over") return null;
    const { verdict, kills, length, truncated, return: sum } = state.result;
    const lines = [`${length} ticks (${(length * world.seconds).toFixed(1)} s), ${kills} ${kills === 1 ? "kill" : "kills"}` +
      `${world.teams ? " of your team" : ""}, return ${sum}`];
    if (truncated) lines.unshift("Time is up.");
    if (state.death) lines.push(death());
    return [VERDICTS[verdict], lines, state.steers];
  }

  function death() {
    const { kind, cause, by, side, tick } = state.death, killer = by >= 0 ? `Agent ${by}` : `Side ${side}`;
    const deed = kind === "kill" ? `${killer} killed you` : "You died";
    return `${deed}${cause && ` (${cause})`} after ${(tick * world.seconds).toFixed(1)} s.`;
  }

  function show() {
    const [title, lines, next] = card() || ["", [], false];
    $("card").hidden = !title;
    $("card").dataset.phase = state.phase;
    $("card").children[0].textContent = title;
    $("card").children[1].textContent = lines.join("\n");
    $("card").children[2].hidden = !next;
    const badge = !state.steers ? "Another page steers; you watch." :
      state.death && state.phase === "running" ? `${death()} The others play on.` : "";
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
    Keys.explain($("keys"), HINTS);
    Keys.buttons($("buttons"));
    document.title = `outlast: ${world.name}`;
  }

  socket.addEventListener("message", ({ data }) => {
    const message = JSON.parse(data);
    if (message.world) return enter(message.world);
    state = message;
    tellWords();
    tellClock();
    show();
    repaint();
  });
  socket.addEventListener("close", ({ reason }) => {
    $("badge").hidden = false;
    $("badge").textContent = `The game is over: ${reason || "the server is gone"}. Start outlast play again.`;
    document.body.classList.add("gone");
  });

  // ---- the person

  const act = {
    KeyV: () => look(!seeing),
    KeyR: () => command("restart"),
    KeyP: () => command(state && state.phase === "paused" ? "resume" : "pause"),
  };

  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    if (Keys.keydown(event)) event.preventDefault(); // the page must not scroll, nor a button be pressed by the space bar
    else if (act[event.code] && !event.repeat) act[event.code]();
  });
  addEventListener("keyup", (event) => {
    if (Keys.keyup(event)) event.preventDefault();
  });
  addEventListener("blur", () => Keys.releaseAll());
  document.addEventListener("visibilitychange", () => document.hidden && command("pause"));
  addEventListener("resize", repaint);
  dark.addEventListener("change", dress);

  const press = (button, deed) => button.addEventListener("click", () => { deed(); button.blur(); });
  document.querySelectorAll("[data-command]").forEach((button) => press(button, () => command(button.dataset.command)));
  press($("pause"), act.KeyP);
  press($("view"), act.KeyV);
  $("pace").append(...SPEEDS.map((speed) => new Option(`${speed}×`, speed)));
  $("pace").addEventListener("change", ({ target }) => { send({ speed: Number(target.value) }); target.blur(); });
  Keys.stick($("stick"));
  dress();
  look(true);
})();
