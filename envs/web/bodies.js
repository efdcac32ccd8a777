// How bodies look: objects, agents, what is written over them, and marks of what happened. SIZES: see style.py.
const Bodies = (() => {
  const { circle, ring, line, cross, square, outline, label, side, boxColor } = Brush;
  const FADE = 1; // seconds that a mark stays
  const STAR = [0, 1, 2, 3].map((k) => [Math.cos(k * Math.PI / 2), Math.sin(k * Math.PI / 2)]);

  function item(scene, kind, object) {
    const { x, y, owner } = object, radius = kind.radius || Math.min(kind.width, kind.height) / 2;
    if (kind.role === "other" && !kind.radius) solid(scene, kind, object);
    else Brush.item(scene, kind, owner, x, y, radius);
  }

  function solid(scene, kind, object) {
    const { context, colors, pixel } = scene;
    const wall = kind.role === "wall", rim = Math.max(SIZES.outline, pixel);
    const color = wall ? colors.wall : object.owner < 0 && kind.color || boxColor(scene, object.owner);
    if (kind.radius > 0) {
      circle(scene, object.x, object.y, kind.radius, wall ? color : colors.outline);
      if (!wall) circle(scene, object.x, object.y, kind.radius - rim, color);
      return;
    }
    context.save();
    context.translate(object.x, object.y);
    context.rotate(object.angle);
    if (kind.corners.length) {
      polygon(scene, kind.corners, color, wall ? 0 : rim);
      context.restore();
      return;
    }
    const grow = wall ? pixel : 0, a = kind.width / 2 + grow, b = kind.height / 2 + grow;
    const thin = Math.min(a, b) <= 2 * rim; // no room for an outline
    context.fillStyle = wall || thin ? color : colors.outline;
    context.fillRect(-a, -b, 2 * a, 2 * b);
    if (!wall && !thin) crate(scene, a - rim, b - rim, rim, color);
    context.restore();
  }

  // A polygon with its rim inside of its sides.
  function polygon({ context, colors }, corners, color, rim) {
    context.beginPath();
    outline(context, corners, { x: 0, y: 0, angle: 0 });
    context.fillStyle = color;
    context.fill();
    if (!rim) return;
    context.clip();
    context.strokeStyle = colors.outline;
    context.lineWidth = 2 * rim;
    context.stroke();
  }

  function crate(scene, a, b, rim, color) {
    const { context } = scene;
    context.fillStyle = color;
    context.fillRect(-a, -b, 2 * a, 2 * b);
    if (Math.min(a, b) < 3 * rim) return;
    [a, b] = [a - rim, b - rim];
    context.globalAlpha *= 0.3;
    context.strokeStyle = scene.colors.outline;
    context.lineWidth = rim / 2;
    context.strokeRect(-a, -b, 2 * a, 2 * b);
    line(scene, -a, -b, a, b);
    line(scene, -a, b, a, -b);
  }

  function damage(scene, kind, { x, y, wound }) {
    if (wound && kind.health) bar(scene, x, y, kind.radius || Math.hypot(kind.width, kind.height) / 2, 1 - wound / kind.health);
  }

  // As far as what was hit, or as far as the weapon reaches.
  function strike(scene, agent) {
    if (!agent.strike || !scene.description.reach) return;
    const { context, colors, pixel } = scene, end = tip(scene, agent), hit = agent.strike > 1;
    context.strokeStyle = colors.ink;
    context.lineWidth = hit ? Math.max(2 * SIZES.strike, 4 * pixel) : Math.max(SIZES.strike / 2, pixel);
    line(scene, agent.x, agent.y, ...end);
    if (!hit) return;
    context.strokeStyle = colors.strike;
    context.lineWidth = Math.max(SIZES.strike, 2 * pixel);
    line(scene, agent.x, agent.y, ...end);
  }

  function hit(scene, agent) {
    if (agent.strike < 2 || !scene.description.reach) return;
    const { colors, pixel } = scene, end = tip(scene, agent), size = Math.max(SIZES.star, 4 * pixel);
    star(scene, ...end, size + Math.max(SIZES.star_rim, pixel), colors.outline);
    star(scene, ...end, size, colors.strike);
    star(scene, ...end, size / 2, colors.white);
  }

  // Two squares, one on the corners of the other.
  function star({ context }, x, y, radius, color) {
    context.fillStyle = color;
    context.beginPath();
    for (const angle of [0, Math.PI / 4]) outline(context, STAR, { x, y, angle }, radius);
    context.fill();
  }

  function tip({ description, snapshot }, agent) {
    const { agents, objects } = snapshot, { target } = agent;
    const shape = target < agents.length ? description.agents[target] : description.objects[target - agents.length];
    const body = target < agents.length ? agents[target] : objects[target - agents.length];
    const { reach } = description.agents[agents.indexOf(agent)];
    const far = Math.min(reach, target < 0 ? Infinity : distance(agent, shape, body));
    return [agent.x + far * Math.cos(agent.angle), agent.y + far * Math.sin(agent.angle)];
  }

  // How far ahead of an agent a body begins; if it is not ahead any more, how far its middle is.
  function distance(agent, shape, body) {
    const x = body.x - agent.x, y = body.y - agent.y, cosine = Math.cos(agent.angle), sine = Math.sin(agent.angle);
    const ahead = x * cosine + y * sine, aside = y * cosine - x * sine;
    const enter = Sight.enter({ ...shape, x: ahead, y: aside, angle: body.angle - agent.angle }, 1, 0);
    return Math.max(0, enter < Infinity ? enter : ahead);
  }

  function agent(scene, agent, i) {
    const { context, description, options, colors, pixel } = scene;
    const { radius } = description.agents[i], { color, ink } = side(scene, i);
    if (options.follow === i) halo(scene, agent, radius, color);
    context.fillStyle = colors.ink;
    context.beginPath();
    outline(context, SIZES.beak, agent, radius);
    context.fill();
    circle(scene, agent.x, agent.y, radius, colors.outline);
    circle(scene, agent.x, agent.y, radius - Math.max(SIZES.outline, pixel), color);
    if (scene.show.ids) label(scene, String(i), agent.x, agent.y, 1.3 * radius, ink, 700);
  }

  function halo(scene, agent, radius, color) {
    const { context, pixel } = scene, alpha = context.globalAlpha;
    context.strokeStyle = color;
    context.lineWidth = Math.max(radius / 5, 2 * pixel);
    ring(scene, agent.x, agent.y, 1.75 * radius);
    context.globalAlpha = 0.2 * alpha;
    circle(scene, agent.x, agent.y, 1.75 * radius, color);
    context.globalAlpha = alpha;
  }

  function health(scene, agent, i) {
    const { health: whole, radius } = scene.description.agents[i];
    if (whole) bar(scene, agent.x, agent.y, radius, agent.health / whole);
  }

  // The colour of a bar by its name.
  const healthColor = (share) => (share > SIZES.hurt ? "whole" : share > SIZES.dying ? "hurt" : "dying");

  // Above a body, as long as the hit points are many: full at those of the start, longer with more, up to twice.
  function bar(scene, x, y, radius, share) {
    const { context, colors, pixel } = scene, { bar_length: length, bar_height: height } = SIZES;
    const left = x - length / 2, lower = y + Math.min(radius, SIZES.bar_lift) + SIZES.bar_gap * height;
    const filled = length * Math.min(Math.max(share, 0), 2), full = Math.min(filled, length);
    const fill = (color, from, wide) => {
      context.fillStyle = color;
      context.fillRect(left + from, lower, wide, height);
    };
    context.fillStyle = colors.outline;
    context.fillRect(left - pixel, lower - pixel, Math.max(length, filled) + 2 * pixel, height + 2 * pixel);
    fill(colors[healthColor(share)], 0, full);
    if (filled > length) fill(colors.extra, length, filled - length);
  }

  // Carried items in a row below; the last one, which is the one in use, on the right.
  function bag(scene, agent, i) {
    const { description, snapshot } = scene, half = SIZES.bag_half, step = SIZES.bag_step * half;
    const y = agent.y - description.agents[i].radius - SIZES.bag_below * half;
    agent.bag.forEach((j, k) => {
      const x = agent.x + step * (k - (agent.bag.length - 1) / 2);
      Brush.item(scene, description.objects[j], snapshot.objects[j].owner, x, y, half);
    });
  }

  // An event a moment ago, fading: a ring that grows, and for deaths a cross. See World.draw.
  function mark(scene, { x, y, age, kind, agent, object }) {
    const { context, description, colors, pixel } = scene, death = kind === "kill" || kind === "death";
    context.globalAlpha = (1 - age) ** 2;
    context.strokeStyle = agent < 0 ? colors.ink : side(scene, agent).color;
    context.lineWidth = Math.max(0.12, 2 * pixel) * (1 - age / 2);
    ring(scene, x, y, 0.5 + 1.3 * age);
    context.globalAlpha = Math.min(1, 3 * (1 - age));
    if (death) {
      context.lineWidth = Math.max(0.2, 2 * pixel);
      cross(scene, x, y, 0.35);
    }
    const words = kind === "heal" ? `+${description.objects[object].amount}` : death ? `${agent} died` : "";
    if (words) label(scene, words, x, y + 1.55 + 0.5 * age, 0.55, colors.ink, 700);
    context.globalAlpha = 1;
  }

  return { FADE, item, solid, damage, strike, hit, agent, health, healthColor, bag, mark };
})();
