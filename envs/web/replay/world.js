// World.draw paints a snapshot on a 2d context: a pure function of (description, snapshot, options), see trace.py.
//
// options: width, height (CSS pixels), ratio (device pixels in one), colors (a theme of colors.py), camera {x, y, half}
// (metres), follow (an agent, -1: none), show {cones, lines, zone, ids, health, bags, trails, blind} (true or false; blind:
// fade what the followed agent does not see), trails [[[x, y] ...] of each agent], marks [{x, y, kind, age}] (age 0 to 1).
const World = (() => {
  const { circle, ring, line, side } = Brush;
  const FAINT = 0.16;

  function draw(context, description, snapshot, options) {
    const { width, height, ratio, camera, colors } = options;
    const scale = Math.min(width, height) / (2 * camera.half);
    const stage = { context, description, snapshot, options, colors, scale, show: options.show, pixel: 1 / scale };
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const unit = ratio * scale;
    context.setTransform(unit, 0, 0, -unit,
      ratio * width / 2 - unit * camera.x, ratio * height / 2 + unit * camera.y);
    context.lineJoin = context.lineCap = "round";
    floor(stage);
    if (stage.show.trails) trails(stage);
    if (stage.show.cones && description.cone) inside(stage, () => watchers(stage).forEach((agent) => cone(stage, agent)));
    if (stage.show.lines) watchers(stage).forEach((agent) => lines(stage, agent));
    things(stage, ["heal", "item", "box_item", "other"], Bodies.item);
    things(stage, ["box", "wall"], Bodies.solid);
    agents(stage, Bodies.strike);
    agents(stage, Bodies.agent);
    agents(stage, Bodies.hit);
    if (stage.show.health) things(stage, ["box"], Bodies.wounds);
    if (stage.show.health) agents(stage, Bodies.health);
    if (stage.show.bags) agents(stage, Bodies.bag);
    (options.marks || []).forEach((mark) => Bodies.mark(stage, mark));
    context.globalAlpha = 1;
  }

  // ---- the ground

  function floor(stage) {
    const { context, snapshot, colors, show } = stage, half = edge(stage);
    const zone = show.zone && snapshot.zone;
    context.fillStyle = zone ? colors.unsafe : colors.floor;
    context.fillRect(-half, -half, 2 * half, 2 * half);
    inside(stage, () => {
      if (zone && zone[2] > 0) circle(stage, zone[0], zone[1], zone[2], colors.floor);
      grid(stage, half);
      if (zone) rims(stage, zone);
    });
  }

  // Metres from the middle to the edge of the floor.
  function edge({ description }) {
    return (description.room || 2 * description.half) / 2;
  }

  // Paints what must not reach beyond the floor.
  function inside(stage, paint) {
    const { context } = stage, half = edge(stage);
    context.save();
    context.beginPath();
    context.rect(-half, -half, 2 * half, 2 * half);
    context.clip();
    paint();
    context.restore();
  }

  function grid(stage, half) {
    const { context, colors, pixel } = stage;
    const step = Math.max(1, half / 5);
    context.globalAlpha = 0.09;
    context.strokeStyle = colors.ink;
    context.lineWidth = pixel;
    context.beginPath();
    for (let at = -half + step; at < half - step / 2; at += step) {
      context.moveTo(at, -half); context.lineTo(at, half);
      context.moveTo(-half, at); context.lineTo(half, at);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  function rims(stage, [x, y, radius, nextX, nextY, nextRadius]) {
    const { context, colors, pixel } = stage;
    context.strokeStyle = colors.rim;
    context.lineWidth = Math.max(0.1, 1.5 * pixel);
    if (radius > 0) ring(stage, x, y, radius);
    if (nextRadius > 0) {
      context.setLineDash([0.5, 0.6]);
      ring(stage, nextX, nextY, nextRadius);
      context.setLineDash([]);
    } else if (radius > 0) {
      line(stage, nextX - 0.6, nextY - 0.6, nextX + 0.6, nextY + 0.6);
      line(stage, nextX - 0.6, nextY + 0.6, nextX + 0.6, nextY - 0.6);
    }
  }

  function trails(stage) {
    const { context, options, pixel } = stage;
    context.lineCap = "butt";
    (options.trails || []).forEach((points, i) => {
      context.strokeStyle = side(stage, i).color;
      context.lineWidth = Math.max(0.12, 2 * pixel);
      for (let k = 1; k < points.length; k++) {
        context.globalAlpha = 0.5 * k / points.length;
        line(stage, ...points[k - 1], ...points[k]);
      }
    });
    context.globalAlpha = 1;
    context.lineCap = "round";
  }

  // ---- sight: of everybody, or of the agent that is followed

  function watchers({ snapshot, options }) {
    return snapshot.agents.filter((agent, i) => agent.alive && (options.follow < 0 || options.follow === i));
  }

  function cone(stage, agent) {
    const { context, description, snapshot } = stage;
    const { fov, depth, kind } = description.cone;
    const { color } = side(stage, snapshot.agents.indexOf(agent));
    context.beginPath();
    context.moveTo(agent.x, agent.y);
    if (kind === "sector") context.arc(agent.x, agent.y, depth, agent.angle - fov / 2, agent.angle + fov / 2);
    else for (const bearing of [-fov / 2, 0, fov / 2]) {
      context.lineTo(agent.x + depth * Math.cos(agent.angle + bearing), agent.y + depth * Math.sin(agent.angle + bearing));
    }
    context.closePath();
    context.fillStyle = context.strokeStyle = color;
    context.globalAlpha = FAINT;
    context.fill();
    context.globalAlpha = 2 * FAINT;
    context.lineWidth = stage.pixel;
    context.stroke();
    context.globalAlpha = 1;
  }

  function lines(stage, agent) {
    const { context, snapshot } = stage;
    const bodies = [...snapshot.agents, ...snapshot.things];
    context.strokeStyle = side(stage, snapshot.agents.indexOf(agent)).color;
    context.lineWidth = Math.max(0.05, 1.25 * stage.pixel);
    context.globalAlpha = 0.8;
    for (const k of agent.sees || []) {
      if (bodies[k].alive || bodies[k].here) line(stage, agent.x, agent.y, bodies[k].x, bodies[k].y);
    }
    context.globalAlpha = 1;
  }

  // Paints body number k, faintly if the followed agent does not see it.
  function seen(stage, k, paint) {
    const { context, options, snapshot, show } = stage;
    const watcher = show.blind && options.follow !== k && snapshot.agents[options.follow];
    context.globalAlpha = watcher && watcher.alive && watcher.sees && !watcher.sees.includes(k) ? 0.2 : 1;
    paint();
    context.globalAlpha = 1;
  }

  // ---- who is in the world

  function agents(stage, paint) {
    stage.snapshot.agents.forEach((agent, i) => {
      if (agent.alive) seen(stage, i, () => paint(stage, agent, i));
    });
  }

  function things(stage, roles, paint) {
    const { description, snapshot } = stage;
    description.things.forEach((kind, j) => {
      const thing = snapshot.things[j];
      if (!thing.here || !roles.includes(kind.role)) return;
      if (kind.role === "wall") paint(stage, kind, thing);
      else seen(stage, snapshot.agents.length + j, () => paint(stage, kind, thing));
    });
  }

  return { draw };
})();
