// How bodies look: things, agents, what is written over them, and marks of what happened.
const Bodies = (() => {
  const { circle, ring, line, square, label, side, glyph } = Brush;
  const BEAK = [[0.6, 0.78], [1.5, 0], [0.6, -0.78]]; // corners, in radii ahead and to the left
  const BAR = { length: 1.2, height: 0.18 }; // metres

  function item(stage, kind, thing) {
    const radius = kind.radius || Math.min(kind.width, kind.height) / 2;
    glyph(stage, kind, thing.owner, thing.x, thing.y, radius);
    if (kind.role === "item" || kind.role === "other") {
      label(stage, kind.kind.replaceAll("_", " "), thing.x, thing.y - radius - 0.32, 0.45, stage.colors.ink);
    }
  }

  function solid(stage, kind, thing) {
    const { context, description, colors, pixel } = stage;
    const wall = kind.role === "wall", rim = Math.max(0.07, pixel);
    const color = wall ? colors.wall : thing.owner < 0 ? colors.box : description.sides[thing.owner].box;
    if (kind.radius > 0) {
      circle(stage, thing.x, thing.y, kind.radius, wall ? color : colors.outline);
      if (!wall) circle(stage, thing.x, thing.y, kind.radius - rim, color);
      return;
    }
    context.save();
    context.translate(thing.x, thing.y);
    context.rotate(thing.angle);
    const grow = wall ? pixel : 0, a = kind.width / 2 + grow, b = kind.height / 2 + grow;
    const thin = Math.min(a, b) <= 1.5 * rim; // no room for an outline
    context.fillStyle = wall || thin ? color : colors.outline;
    context.fillRect(-a, -b, 2 * a, 2 * b);
    if (!wall && !thin) crate(stage, a - rim, b - rim, rim, color);
    context.restore();
  }

  function crate(stage, a, b, rim, color) {
    const { context } = stage;
    context.fillStyle = color;
    context.fillRect(-a, -b, 2 * a, 2 * b);
    const inset = 1.2 * rim;
    if (Math.min(a, b) < 2.5 * inset) return;
    context.globalAlpha *= 0.3;
    context.strokeStyle = stage.colors.outline;
    context.lineWidth = 0.6 * rim;
    context.strokeRect(-a + inset, -b + inset, 2 * (a - inset), 2 * (b - inset));
    line(stage, -a + inset, -b + inset, a - inset, b - inset);
    line(stage, -a + inset, b - inset, a - inset, -b + inset);
  }

  function wounds(stage, kind, thing) {
    if (!thing.wound || !kind.health) return;
    bar(stage, thing.x, thing.y + Math.min(Math.hypot(kind.width, kind.height) / 2, 0.6), 1 - thing.wound / kind.health);
  }

  // Up to what it met, or as far as the weapon reaches.
  function strike(stage, agent) {
    if (!agent.strike || !stage.description.reach) return;
    const { context, colors, pixel } = stage, end = tip(stage, agent);
    context.strokeStyle = colors.ink;
    context.lineWidth = agent.strike > 1 ? Math.max(0.3, 4 * pixel) : Math.max(0.08, pixel);
    line(stage, agent.x, agent.y, ...end);
    if (agent.strike < 2) return;
    context.strokeStyle = colors.strike;
    context.lineWidth = Math.max(0.16, 2 * pixel);
    line(stage, agent.x, agent.y, ...end);
  }

  function hit(stage, agent) {
    if (agent.strike < 2 || !stage.description.reach) return;
    const { colors, pixel } = stage, end = tip(stage, agent), size = Math.max(0.26, 4 * pixel);
    star(stage, ...end, size + Math.max(0.08, pixel), colors.outline);
    star(stage, ...end, size, colors.strike);
    star(stage, ...end, size / 2, colors.white);
  }

  function star({ context }, x, y, radius, color) {
    context.fillStyle = color;
    context.beginPath();
    for (let k = 0; k < 16; k++) {
      const far = k % 2 ? 0.62 * radius : radius, angle = k * Math.PI / 8;
      context.lineTo(x + far * Math.cos(angle), y + far * Math.sin(angle));
    }
    context.fill();
  }

  function tip({ description, snapshot }, agent) {
    const { agents, things } = snapshot, { target } = agent;
    const shape = target < agents.length ? description.agents[target] : description.things[target - agents.length];
    const body = target < agents.length ? agents[target] : things[target - agents.length];
    const far = Math.min(description.reach, target < 0 ? Infinity : distance(agent, shape, body));
    return [agent.x + far * Math.cos(agent.angle), agent.y + far * Math.sin(agent.angle)];
  }

  // How far ahead of an agent a body begins; if it is not ahead any more, how far its middle is.
  function distance(agent, { radius, width, height }, body) {
    const x = body.x - agent.x, y = body.y - agent.y, cosine = Math.cos(agent.angle), sine = Math.sin(agent.angle);
    const ahead = x * cosine + y * sine, aside = y * cosine - x * sine;
    if (radius > 0) return Math.max(0, ahead - Math.sqrt(Math.max(0, radius ** 2 - aside ** 2)));
    const [c, s] = [Math.cos(body.angle), Math.sin(body.angle)];
    const slab = (place, speed, half) => [(place - half) / speed, (place + half) / speed].sort((a, b) => a - b);
    const [near, far] = slab(x * c + y * s, cosine * c + sine * s, width / 2);
    const [from, to] = slab(y * c - x * s, sine * c - cosine * s, height / 2);
    const enter = Math.max(near, from);
    return Math.max(0, enter <= Math.min(far, to) ? enter : ahead);
  }

  function agent(stage, agent, i) {
    const { context, description, options, colors, pixel } = stage;
    const { radius } = description.agents[i], { color, ink } = side(stage, i);
    if (options.follow === i) halo(stage, agent, radius, color);
    const cosine = radius * Math.cos(agent.angle), sine = radius * Math.sin(agent.angle);
    context.fillStyle = colors.ink;
    context.beginPath();
    BEAK.forEach(([a, b]) => context.lineTo(agent.x + a * cosine - b * sine, agent.y + a * sine + b * cosine));
    context.fill();
    circle(stage, agent.x, agent.y, radius, colors.outline);
    circle(stage, agent.x, agent.y, radius - Math.max(0.07, pixel), color);
    if (stage.show.ids) label(stage, String(i), agent.x, agent.y, 1.3 * radius, ink, 700);
  }

  function halo(stage, agent, radius, color) {
    const { context, pixel } = stage, alpha = context.globalAlpha;
    context.strokeStyle = color;
    context.lineWidth = Math.max(0.1, 2 * pixel);
    context.globalAlpha = 0.9 * alpha;
    ring(stage, agent.x, agent.y, 1.75 * radius);
    context.globalAlpha = 0.18 * alpha;
    circle(stage, agent.x, agent.y, 1.75 * radius, color);
    context.globalAlpha = alpha;
  }

  function health(stage, agent, i) {
    const whole = stage.description.health;
    if (whole) bar(stage, agent.x, agent.y + stage.description.agents[i].radius, agent.health / whole);
  }

  // Full at the health of birth; what is beyond lies over it in another colour.
  function bar(stage, x, y, share) {
    const { context, colors, pixel } = stage, edge = Math.max(pixel, 0.03);
    const left = x - BAR.length / 2, lower = y + 1.6 * BAR.height;
    const fill = (color, part) => {
      context.fillStyle = color;
      context.fillRect(left, lower, BAR.length * Math.min(Math.max(part, 0), 1), BAR.height);
    };
    context.fillStyle = colors.outline;
    context.fillRect(left - edge, lower - edge, BAR.length + 2 * edge, BAR.height + 2 * edge);
    fill(share > 0.5 ? colors.whole : share > 0.25 ? colors.hurt : colors.dying, share);
    if (share > 1) fill(colors.beyond, share - 1);
  }

  // Carried items in a row below; the last one, which is the one in use, on the right.
  function bag(stage, agent, i) {
    const { description, snapshot } = stage, half = 0.17, step = 2.5 * half;
    agent.bag.forEach((j, k) => {
      const x = agent.x + step * (k - (agent.bag.length - 1) / 2);
      const y = agent.y - description.agents[i].radius - 2.1 * half;
      glyph(stage, description.things[j], snapshot.things[j].owner, x, y, half);
    });
  }

  // What happened a moment ago, fading: a ring that grows, and for deaths a cross where it was.
  function mark(stage, { x, y, kind, age, color, words }) {
    const { context, colors, pixel } = stage;
    context.globalAlpha = (1 - age) ** 2;
    context.strokeStyle = color || colors.ink;
    context.lineWidth = Math.max(0.1, 2 * pixel) * (1 - age / 2);
    ring(stage, x, y, 0.5 + 1.3 * age);
    context.globalAlpha = Math.min(1, 3 * (1 - age));
    if (kind === "kill" || kind === "death") {
      context.lineWidth = Math.max(0.16, 2.5 * pixel);
      line(stage, x - 0.35, y - 0.35, x + 0.35, y + 0.35);
      line(stage, x - 0.35, y + 0.35, x + 0.35, y - 0.35);
    }
    if (words) label(stage, words, x, y + 1.55 + 0.5 * age, 0.55, colors.ink, 700);
    context.globalAlpha = 1;
  }

  return { item, solid, wounds, strike, hit, agent, health, bag, mark };
})();
