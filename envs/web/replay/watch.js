// Watching a run: plays its newest checkpoint, episode after episode, and shows the numbers of the run beside it.
(() => {
  // milliseconds: between looks at the run, and while an episode is not whole; from the end of an episode to the next one
  const EVERY = 2000, SOON = 500, REST = 1500;
  const SVG = "http://www.w3.org/2000/svg", WIDE = 100, HIGH = 26;
  const LOST = "There is no answer: is outlast watch still running?";
  const { $ } = Dom;

  // ---- the page: that of a replay, with the run above the agents

  Viewport.applyTheme();
  const section = Dom.make("section", "run");
  document.querySelector("aside").prepend(section);
  const line = Dom.make("p", "checkpoint", section);
  const playing = Dom.make("b", "", line), about = Dom.make("span", "", line);
  const skip = Dom.make("button", "", section, "Play the newest now");
  const message = Dom.make("p", "message", section);
  message.id = "message";
  message.setAttribute("role", "status");
  const charts = Dom.make("dl", "charts", section), numbers = Dom.make("p", "numbers", section), cells = new Map();
  const run = $("title").textContent;
  Dom.make("p", "empty", $("stage").parentElement, "Waiting …");
  skip.hidden = true;
  message.hidden = true;
  document.body.className = "waiting"; // for the first episode: the player's own parts are of no use yet

  // ---- the run

  let player = null, shown = null, status = null, busy = false, timer = 0;

  async function get(name) {
    const answer = await fetch(name, { cache: "no-store" });
    if (!answer.ok) throw new Error(answer.statusText);
    return answer.json();
  }

  async function look() {
    clearTimeout(timer);
    try {
      const found = document.hidden ? null : await get("status.json").catch(() => say(LOST));
      if (!found) return;
      status = found;
      describe();
      if (status.episode && !shown?.whole) await next();
    } finally {
      timer = setTimeout(look, shown?.whole ? EVERY : SOON);
    }
  }

  // The newest episode: another one, or more of the same, which goes on, or if there is no more of it, the same again.
  async function next() {
    if (busy) return;
    busy = true;
    try {
      const episode = await get("episode.json"), same = shown?.number === episode.number;
      if (same && shown.ticks === episode.ticks && shown.whole === episode.whole) {
        if (shown.whole) player.play();
      } else {
        if (player) await player.load(episode.data, same);
        else await begin(episode.data);
        shown = status.episode = episode;
        Dom.write(playing, `${steps(shown.steps)} agent-steps`);
        Dom.write($("title"), `${shown.game}: ${run}`);
        compare();
      }
    } catch (error) {
      say(player ? LOST : `This episode cannot be played here: ${error.message}. A current browser is needed.`);
      if (player) player.play();
    }
    busy = false;
  }

  async function begin(data) {
    document.body.className = "";
    player = await Player.start(data);
  }

  document.addEventListener("ended", () => setTimeout(() => { if (player.atEnd()) next(); }, REST));
  document.addEventListener("visibilitychange", () => { if (!document.hidden) look(); });
  skip.addEventListener("click", next);

  // ---- what is shown of it

  const steps = (count) => count.toLocaleString("en");

  function ago(seconds) {
    for (const [unit, size, most] of [["s", 1, 90], ["min", 60, 5400], ["h", 3600, 129600]]) {
      if (seconds < most) return `${Math.round(seconds / size)} ${unit} ago`;
    }
    return `${Math.round(seconds / 86400)} days ago`;
  }

  function say(text) {
    Dom.write(message, text);
    message.hidden = !text;
  }

  // What is played, beside the newest checkpoint.
  function compare() {
    const { newest, episode } = status;
    if (newest) {
      const same = shown && shown.steps === newest.steps;
      Dom.write(about, same ? `saved ${ago(newest.age)}` : `newest: ${steps(newest.steps)} agent-steps, ${ago(newest.age)}`);
    }
    skip.hidden = !shown || !episode || episode.steps === shown.steps;
  }

  function describe() {
    const { message, figures } = status;
    say(message);
    compare();
    const charted = figures.filter(({ points }) => points).map((figure) => [`${figure.group} ${figure.name}`, figure]);
    for (const [key, cell] of cells) if (!charted.some(([other]) => other === key)) { cell.remove(); cells.delete(key); }
    for (const [key, figure] of charted) write(key, figure);
    Dom.write(numbers, figures.filter(({ points }) => !points).map(({ name, text }) => `${name} ${text}`).join(" · "));
  }

  function write(key, { group, name, text, points }) {
    if (!cells.has(key)) {
      const cell = Dom.make("div", "", charts);
      Dom.make("dt", "", cell, group === "wins" && name !== "own Elo" ? `wins v ${name}` : name);
      Dom.make("dd", "", cell);
      cells.set(key, cell);
    }
    const cell = cells.get(key);
    Dom.write(cell.querySelector("dd"), text);
    if (points.length > 1) chart(cell, points, group === "wins" ? 1 : 0);
  }

  // A line over agent-steps; its scale holds zero and `most`.
  function chart(cell, points, most) {
    const values = points.map(([, value]) => value), first = points[0][0], last = points[points.length - 1][0];
    const low = Math.min(0, ...values), high = Math.max(...values, most, low + 1e-9);
    const place = ([step, value]) => [
      WIDE * (step - first) / (last - first), 1 + (HIGH - 2) * (high - value) / (high - low),
    ].map((length) => length.toFixed(1)).join(",");
    let svg = cell.querySelector("svg");
    if (!svg) {
      svg = document.createElementNS(SVG, "svg");
      svg.setAttribute("viewBox", `0 0 ${WIDE} ${HIGH}`);
      svg.setAttribute("preserveAspectRatio", "none");
      svg.setAttribute("role", "img");
      svg.append(document.createElementNS(SVG, "polyline"));
      cell.append(svg);
    }
    svg.firstChild.setAttribute("points", points.map(place).join(" "));
    const range = [Math.min(...values), Math.max(...values)].map((value) => +value.toPrecision(3));
    const words = `${range.join(" to ")}, from ${steps(first)} to ${steps(last)} agent-steps`;
    svg.setAttribute("aria-label", words);
    cell.title = words;
  }

  look();
})();
