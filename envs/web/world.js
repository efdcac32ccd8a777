// World.draw paints a snapshot on a 2d context: a pure function of (description, snapshot, options), see world_json.py.
//
// options: width, height (CSS pixels), ratio (device pixels in one), colors (a theme of assets.py), camera {x, y, half}
// (metres), follow (an agent, -1: none), show {cones, lines, rays, zone, ids, health, bags, trails, blind, attention, night}
// (true or false; blind: fade what the followed agent does not see; night: darken all that it does not see), trails
// [[[x, y] ...] of each agent], attends [{body, share}]: to what its policy attends, marks [{x, y, age (0 to 1), kind,
// agent, object}]: events of a moment ago.
const World = (() => {
  const { circle, ring, line, cross, outline, side } = Brush;
  const { cone_opacity: FAINT, zone_rim: RIM, zone_dash: DASH } = SIZES;
  const WIDEST = 0.55; // metres: a line to what has all the attention
  const ITEMS = ["heal", "item", "box_item", "other"], SOLIDS = ["box", "wall"]; // roles of objects, see world_json.py
  const LEGEND = { letter: 12, gap: 14 }; // pixels
  const CLEAR = 1.3; // metres around an agent that stay clear at night

  function draw(context, description, snapshot, options) {
    const { width, height, ratio, camera, colors } = options;
    const scale = Math.min(width, height) / (2 * camera.half);
    const scene = { context, description, snapshot, options, colors, scale, show: options.show, pixel: 1 / scale };
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const unit = ratio * scale;
    context.setTransform(unit, 0, 0, -unit,
      ratio * width / 2 - unit * camera.x, ratio * height / 2 + unit * camera.y);
    context.lineJoin = context.lineCap = "round";
    floor(scene);
    if (scene.show.trails) trails(scene);
    if (scene.show.cones && description.cone) inside(scene, () => watchers(scene).forEach((agent) => cone(scene, agent)));
    if (scene.show.lines) watchers(scene).forEach((agent) => lines(scene, agent));
    if (scene.show.rays) watchers(scene).forEach((agent) => rays(scene, agent));
    if (scene.show.attention && options.attends) attention(scene);
    objects(scene, ITEMS, Bodies.item);
    objects(scene, SOLIDS, Bodies.solid);
    looks(scene);
    agents(scene, Bodies.strike);
    agents(scene, Bodies.agent);
    agents(scene, Bodies.hit);
    if (scene.show.health) objects(scene, [...ITEMS, ...SOLIDS], Bodies.damage);
    if (scene.show.health) agents(scene, Bodies.health);
    if (scene.show.bags) agents(scene, Bodies.bag);
    (options.marks || []).forEach((mark) => Bodies.mark(scene, mark));
    if (scene.show.night && description.cone) inside(scene, () => watchers(scene).forEach((agent) => night(scene, agent)));
    context.globalAlpha = 1;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    legend(scene, width);
  }

  // The names of the kinds of items and bodies that are no part of outlast, beside a disc of their colour, in the upper
  // right corner, as far as there is room.
  function legend({ context, description, colors }, width) {
    const own = description.objects.filter(({ role }) => role === "item" || role === "other");
    const kinds = [...new Map(own.map(({ kind, color }) => [kind, color]))].reverse();
    const { letter, gap } = LEGEND, y = letter;
    context.font = `600 ${letter}px ${Brush.FONT}`;
    context.textAlign = "left";
    context.textBaseline = "middle";
    let x = width;
    for (const [kind, color] of kinds) {
      const words = kind.replaceAll("_", " ");
      x -= context.measureText(words).width + 1.4 * letter + gap;
      if (x < 0) return;
      circle({ context }, x + letter / 2, y, letter / 2, color);
      context.fillStyle = colors.ink;
      context.fillText(words, x + 1.4 * letter, y);
    }
  }

  // ---- the ground

  function floor(scene) {
    const { context, snapshot, colors, show } = scene, half = edge(scene), [width, height] = sides(scene);
    const zone = show.zone && snapshot.zone;
    context.fillStyle = zone ? colors.unsafe : colors.floor;
    context.fillRect(-width / 2, -height / 2, width, height);
    inside(scene, () => {
      if (zone && zone[2] > 0) circle(scene, zone[0], zone[1], zone[2], colors.floor);
      grid(scene, half);
      if (zone) rims(scene, zone);
    });
  }

  // Metres, width and height of the floor; without one, of all that is shown.
  function sides({ description: { floor, half } }) {
    return floor.length ? floor : [2 * half, 2 * half];
  }

  // Metres from the middle to the farther edges of the floor.
  function edge(scene) {
    return Math.max(...sides(scene)) / 2;
  }

  // Paints what must not reach beyond the floor.
  function inside(scene, paint) {
    const { context } = scene, [width, height] = sides(scene);
    context.save();
    context.beginPath();
    context.rect(-width / 2, -height / 2, width, height);
    context.clip();
    paint();
    context.restore();
  }

  function grid(scene, half) {
    const { context, colors, pixel } = scene;
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

  function rims(scene, [x, y, radius, nextX, nextY, nextRadius]) {
    const { context, colors, pixel } = scene;
    context.strokeStyle = colors.rim;
    context.lineWidth = Math.max(RIM, 2 * pixel);
    if (radius > 0) ring(scene, x, y, radius);
    if (nextRadius > 0) {
      context.setLineDash([DASH, DASH]);
      ring(scene, nextX, nextY, nextRadius);
      context.setLineDash([]);
    } else if (radius > 0) {
      cross(scene, nextX, nextY, DASH);
    }
  }

  function trails(scene) {
    const { context, options, pixel } = scene;
    context.lineCap = "butt";
    (options.trails || []).forEach((points, i) => {
      if (!points.length) return; // absent: it has no side either
      context.strokeStyle = side(scene, i).color;
      context.lineWidth = Math.max(0.12, 2 * pixel);
      for (let k = 1; k < points.length; k++) {
        context.globalAlpha = 0.5 * k / points.length;
        line(scene, ...points[k - 1], ...points[k]);
      }
    });
    context.globalAlpha = 1;
    context.lineCap = "round";
  }

  // ---- sight: of everybody, or of the agent that is followed

  function watchers({ snapshot, options }) {
    return snapshot.agents.filter((agent, i) => agent.alive && (options.follow < 0 || options.follow === i));
  }

  function cone(scene, agent) {
    const { context, description, snapshot } = scene, i = snapshot.agents.indexOf(agent);
    context.beginPath();
    outline(context, Sight.cone(description, snapshot, i), agent);
    context.fillStyle = context.strokeStyle = side(scene, i).color;
    context.globalAlpha = FAINT;
    context.fill();
    context.globalAlpha = 2 * FAINT;
    context.lineWidth = scene.pixel;
    context.stroke();
    context.globalAlpha = 1;
  }

  // Darkens what an agent does not see, but for a disc around it. Bodies that it sees are clear as a whole.
  function night(scene, agent) {
    const { context, description, snapshot, colors } = scene, half = edge(scene), far = 100 * half;
    const seen = Sight.cone(description, snapshot, snapshot.agents.indexOf(agent));
    const clip = (add) => {
      const path = new Path2D();
      path.rect(-far, -far, 2 * far, 2 * far);
      add(path);
      context.clip(path, "evenodd");
    };
    context.save();
    clip((path) => outline(path, seen, agent));
    clip((path) => path.arc(agent.x, agent.y, CLEAR, 0, 2 * Math.PI));
    for (const k of agent.sees || []) clip((path) => silhouette(path, scene, k));
    context.fillStyle = colors.night;
    context.globalAlpha = 0.45;
    context.fillRect(-half, -half, 2 * half, 2 * half);
    context.restore();
  }

  // Adds the outline of body number k to a path.
  function silhouette(path, { description, snapshot }, k) {
    const count = snapshot.agents.length, shape = k < count ? description.agents[k] : description.objects[k - count];
    const body = k < count ? snapshot.agents[k] : snapshot.objects[k - count];
    if (shape.radius > 0) path.arc(body.x, body.y, shape.radius, 0, 2 * Math.PI);
    else outline(path, Brush.cornersOf(shape), body);
  }

  function lines(scene, agent) {
    const { context, snapshot } = scene;
    const bodies = [...snapshot.agents, ...snapshot.objects];
    context.strokeStyle = side(scene, snapshot.agents.indexOf(agent)).color;
    context.lineWidth = Math.max(SIZES.sight_line, scene.pixel);
    context.globalAlpha = 0.8;
    for (const k of agent.sees || []) {
      if (bodies[k].alive || bodies[k].here) line(scene, agent.x, agent.y, bodies[k].x, bodies[k].y);
    }
    context.globalAlpha = 1;
  }

  // A line along each ray of an agent's lidar, up to what it hits.
  function rays(scene, agent) {
    const { context, description, snapshot } = scene, i = snapshot.agents.indexOf(agent);
    const cosine = Math.cos(agent.angle), sine = Math.sin(agent.angle);
    context.strokeStyle = side(scene, i).color;
    context.lineWidth = Math.max(SIZES.ray, scene.pixel);
    context.globalAlpha = 0.8;
    description.agents[i].rays.forEach(([ahead, left], k) => {
      const far = agent.rays[k];
      line(scene, agent.x, agent.y, agent.x + far * (cosine * ahead - sine * left), agent.y + far * (sine * ahead + cosine * left));
    });
    context.globalAlpha = 1;
  }

  // From the followed agent to what its policy attends to: the wider, the more.
  function attention(scene) {
    const { context, snapshot, options, colors, pixel } = scene, bodies = [...snapshot.agents, ...snapshot.objects];
    const me = snapshot.agents[options.follow];
    context.strokeStyle = colors.extra;
    for (const { body, share } of options.attends) {
      if (body < 0 || share <= 0 || !(bodies[body].alive || bodies[body].here)) continue;
      context.globalAlpha = Math.min(0.85, 0.2 + share);
      context.lineWidth = Math.max(WIDEST * share, pixel / 2);
      line(scene, me.x, me.y, bodies[body].x, bodies[body].y);
    }
    context.globalAlpha = 1;
  }

  // Paints body number k, faintly if the followed agent does not see it.
  function seen(scene, k, paint) {
    const { context, options, snapshot, show } = scene;
    const watcher = show.blind && options.follow !== k && snapshot.agents[options.follow];
    context.globalAlpha = watcher && watcher.alive && watcher.sees && !watcher.sees.includes(k) ? 0.2 : 1;
    paint();
    context.globalAlpha = 1;
  }

  // Rings around bodies, and lines between them, as the looks of their kinds say.
  function looks(scene) {
    const { context, description, snapshot, colors, pixel } = scene;
    const bodies = [...snapshot.agents, ...snapshot.objects], shapes = [...description.agents, ...description.objects];
    context.strokeStyle = colors.ink;
    context.lineWidth = Math.max(2 * SIZES.sight_line, pixel);
    bodies.forEach((body, k) => {
      if (!(body.alive || body.here)) return;
      const { radius, width, height } = shapes[k], other = bodies[snapshot.lines[k]];
      if (snapshot.rings[k]) ring(scene, body.x, body.y, (radius || Math.hypot(width, height) / 2) + 3 * SIZES.sight_line);
      if (other && (other.alive || other.here)) line(scene, body.x, body.y, other.x, other.y);
    });
  }

  // ---- who is in the world

  function agents(scene, paint) {
    scene.snapshot.agents.forEach((agent, i) => {
      if (agent.alive) seen(scene, i, () => paint(scene, agent, i));
    });
  }

  function objects(scene, roles, paint) {
    const { description, snapshot } = scene;
    description.objects.forEach((kind, j) => {
      const object = snapshot.objects[j];
      if (!object.here || !roles.includes(kind.role)) return;
      if (kind.role === "wall") paint(scene, kind, object);
      else seen(scene, snapshot.agents.length + j, () => paint(scene, kind, object));
    });
  }

  return { draw };
})();
