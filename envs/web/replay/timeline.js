// Timeline: how the zone shrinks, a strip for each agent's health, signs where something happened, and returns.
const Timeline = (() => {
  const ZONE = 12, AXIS = 16, SNAP = 7; // pixels: height of the zone's strip and of the axis, reach of a click on a sign
  const CURVES = 48, FLAT = 32, GAP = 5; // pixels: height of the curves of returns, on small screens, and free above them
  const STRIPS = 150, DENSE = 84; // pixels for all strips together, and with another recording beside
  const SIGNS = { kill: 4, death: 4, heal: 3, use: 2, place: 1, break: 0 }; // later ones lie on top
  const LEFT = 30, RIGHT = 10;

  // onSeek(k) is called with the row that was clicked or dragged to. Returns {resize, show, draw}.
  function build(canvas, tip, onSeek) {
    const context = canvas.getContext("2d");
    let episode = null, order = [], colors = null, scale = null, follow = -1, at = 0, ratio = 1, width = 0, height = 0, still = null, dragging = false;

    const present = () => Math.max(...order, -1) + 1;
    const strip = () => Math.max(1, Math.min(18, Math.floor((scale.dense ? DENSE : STRIPS) / Math.max(1, present()))));
    const below = (n) => (episode.description.zone ? ZONE + 4 : 0) + n * (strip() + (strip() < 3 ? 0 : strip() < 8 ? 1 : 3));
    const top = (i) => below(order[i]);
    const curves = () => below(present()) + GAP;
    const tall = () => (scale.dense || window.innerHeight < 700 || width < 500 ? FLAT : CURVES);
    const last = () => Math.max(1, scale.ticks - 1);
    const place = (k) => LEFT + (width - LEFT - RIGHT) * k / last();
    const paid = () => scale.high > scale.low;
    const index = (x) => Math.min(last(), Math.max(0, Math.round((x - LEFT) / (width - LEFT - RIGHT) * last())));

    // size: {ticks, low, high, dense}, how many rows there is room for and the range of returns, which recordings side
    // by side have in common; low and high are 0 where nobody is paid; dense: whether there are two.
    function show(shown, theme, size) {
      [episode, colors, scale] = [shown, theme, size];
      let strips = 0;
      order = episode.description.agents.map(({ side }) => (side < 0 ? -1 : strips++)); // absent ones have none
      resize();
    }

    function resize() {
      if (!episode) return;
      width = canvas.clientWidth;
      height = below(present()) + (paid() ? GAP + tall() + GAP : 0) + AXIS;
      canvas.style.height = `${height}px`;
      ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      still = document.createElement("canvas");
      still.width = canvas.width;
      still.height = canvas.height;
      paint(still.getContext("2d"));
      draw(at, follow);
    }

    // ---- all that stays, painted once

    function paint(pen) {
      pen.scale(ratio, ratio);
      if (episode.description.zone) zone(pen);
      episode.description.agents.forEach((_, i) => health(pen, i));
      axis(pen);
      if (paid()) returns(pen);
      const events = episode.events.filter(({ kind }) => kind in SIGNS);
      events.sort((a, b) => SIGNS[a.kind] - SIGNS[b.kind]).forEach((event) => sign(pen, event));
    }

    function zone(pen) {
      const radii = episode.history("zone", 2), most = Math.max(1, ...radii.subarray(0, 1));
      area(pen, 0, ZONE, (k) => radii[k] / most, colors.rim, 0.45);
      pen.strokeStyle = colors.rim;
      pen.lineWidth = 1.5;
      Brush.ring({ context: pen }, LEFT - 11, ZONE / 2, ZONE / 2 - 1.5);
    }

    function health(pen, i) {
      if (order[i] < 0) return;
      const { description } = episode, y = top(i), tall = strip();
      const points = episode.history("agent.health", i), alive = episode.history("agent.alive", i);
      const { health: full, side } = description.agents[i];
      const whole = 1.25 * Math.max(1, full), color = description.sides[side].color;
      pen.fillStyle = colors.ink;
      pen.globalAlpha = 0.07;
      pen.fillRect(LEFT, y, width - LEFT - RIGHT, tall);
      pen.globalAlpha = 1;
      area(pen, y, tall, (k) => alive[k] ? Math.max(0.08, full ? Math.min(1, points[k] / whole) : 0.8) : 0, color, 0.75,
        alive.lastIndexOf(1) + 1); // agents may come back
      if (tall < 8) return;
      write(pen, i, LEFT - 8, y + tall / 2, "right", color, 700);
    }

    // Of every agent, in the colour of its side; zero is a line.
    function returns(pen) {
      pen.fillStyle = pen.strokeStyle = colors.ink;
      pen.globalAlpha = 0.07;
      pen.fillRect(LEFT, curves(), width - LEFT - RIGHT, tall());
      pen.globalAlpha = 0.25;
      Brush.line({ context: pen }, LEFT, level(0), width - RIGHT, level(0));
      pen.lineJoin = "round";
      episode.description.agents.forEach((_, i) => curve(pen, i, 1.5, follow < 0 || follow === i ? 0.9 : 0.35));
      if (follow >= 0 && follow < episode.description.agents.length) curve(pen, follow, 2.5, 1);
      pen.globalAlpha = 0.6;
      write(pen, `return${episode.since}, ${short(scale.low)} to ${short(scale.high)}`, LEFT + 5, curves() + 8, "left", colors.ink, 400);
      pen.globalAlpha = 1;
    }

    const level = (value) => curves() + tall() * (scale.high - value) / (scale.high - scale.low);

    function curve(pen, i, wide, alpha) {
      const { description } = episode, values = episode.returns()[i];
      if (order[i] < 0) return;
      pen.strokeStyle = description.sides[description.agents[i].side].color;
      pen.lineWidth = wide;
      pen.globalAlpha = alpha;
      pen.beginPath();
      values.forEach((value, k) => pen[k ? "lineTo" : "moveTo"](place(k), level(value)));
      pen.stroke();
    }

    const short = (value) => String(+value.toPrecision(4)).replace("-", "−");

    function area(pen, y, tall, share, color, alpha, stop = episode.length) {
      pen.fillStyle = color;
      pen.globalAlpha = alpha;
      pen.beginPath();
      pen.moveTo(place(0), y + tall);
      for (let k = 0; k < stop; k++) {
        pen.lineTo(place(k), y + tall - tall * share(k));
        if (k + 1 < stop) pen.lineTo(place(k + 1), y + tall - tall * share(k));
      }
      pen.lineTo(place(Math.max(0, stop - 1)), y + tall);
      pen.fill();
      pen.globalAlpha = 1;
    }

    function axis(pen) {
      const y = height - AXIS + 8, most = scale.ticks / Math.max(2, Math.floor((width - LEFT) / 90));
      const step = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 1e5, 1e6].find((size) => size >= most) || 1e7;
      for (let tick = Math.ceil(episode.start / step) * step; tick < episode.start + scale.ticks; tick += step) {
        pen.globalAlpha = 0.6;
        write(pen, tick, Math.max(LEFT + 3, place(tick - episode.start)), y, "center", colors.ink, 400);
      }
      pen.globalAlpha = 1;
    }

    function write(pen, words, x, y, align, color, weight) {
      pen.font = `${weight} 11px system-ui, sans-serif`;
      pen.textAlign = align;
      pen.textBaseline = "middle";
      pen.fillStyle = color;
      pen.fillText(words, align === "center" ? Math.min(x, width - pen.measureText(words).width / 2) : x, y);
    }

    function sign(pen, { kind, at: k, agent, by, object }) {
      if (agent < 0) return;
      const { agents, sides } = episode.description, tall = strip();
      const x = place(k), y = top(agent) + tall / 2, half = Math.min(5, tall / 2);
      const { description } = episode, scene = { context: pen, colors, description, pixel: 1 };
      pen.lineCap = "round";
      if (kind === "kill" || kind === "death") {
        Brush.circle(scene, x, y, half + 2.5, colors.card);
        pen.strokeStyle = kind === "kill" ? by >= 0 ? sides[agents[by].side].color : colors.ink : colors.rim;
        pen.lineWidth = 2.25;
        Brush.cross(scene, x, y, half - 1);
      } else if (kind === "break" || kind === "place") {
        const color = Brush.boxColor(scene, episode.row("object.owner", k)[object]);
        Brush.square(scene, x, y, half - 1, colors.outline);
        Brush.square(scene, x, y, half - 2, kind === "place" ? color : colors.card);
      } else Brush.item(scene, description.objects[object], -1, x, y, half - 0.5);
    }

    // ---- what moves

    function draw(k, followed) {
      if (followed !== follow) {
        follow = followed;
        resize();
      }
      at = k;
      if (!still?.width) return; // a frame that is not laid out yet has no width
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.clearRect(0, 0, canvas.width, canvas.height);
      context.drawImage(still, 0, 0);
      context.scale(ratio, ratio);
      const x = place(k);
      context.fillStyle = colors.page;
      context.globalAlpha = 0.45;
      context.fillRect(x, 0, Math.max(0, width - RIGHT - x), height - AXIS);
      context.globalAlpha = 1;
      context.fillStyle = colors.ink;
      context.fillRect(x - 1, 0, 2, height - AXIS);
      Brush.circle({ context }, x, height - AXIS + 1, 4.5, colors.ink);
    }

    // The event whose sign is near a point of the canvas.
    function hit(x, y) {
      const near = (event) => Math.hypot(place(event.at) - x, top(event.agent) + strip() / 2 - y);
      const events = episode.events.filter(({ kind, agent }) => kind in SIGNS && agent >= 0);
      const nearest = events.reduce((best, event) => !best || near(event) <= near(best) ? event : best, null);
      return nearest && near(nearest) <= SNAP ? nearest : null;
    }

    function point(event) {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    }

    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      dragging = true;
      canvas.setPointerCapture(event.pointerId);
      const [x, y] = point(event), found = hit(x, y);
      onSeek(found ? found.at : index(x));
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = point(event), found = hit(x, y);
      if (dragging && Math.abs(place(at) - x) > 2) onSeek(index(x));
      tip.hidden = !found;
      canvas.style.cursor = found ? "pointer" : "default";
      if (found) tip.show(found, place(found.at), top(found.agent));
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { dragging = false; });
    canvas.addEventListener("pointerleave", () => { tip.hidden = true; });

    return { show, resize, draw, place, top: (i) => top(i) + strip() / 2 };
  }

  return { build };
})();
