// Sight: where a vision cone ends, which is where systems/cameras.py lets sight end: at every body that hides.
const Sight = (() => {
  const NUDGE = 1e-4; // radians: rays pass a corner on both sides

  // The corners of what agent i sees of its vision cone, [metres ahead, metres to the left] as description.agents[i].cone.
  // While it is blind, only the eye.
  function cone(description, snapshot, i) {
    if (snapshot.tick < description.agents[i].blind) return [[0, 0]];
    const [, ...rim] = description.agents[i].cone, bearings = rim.map(([x, y]) => Math.atan2(y, x));
    const [first, last] = [bearings[0], bearings[bearings.length - 1]];
    const bodies = hiding(description, snapshot, i);
    const rays = bodies.flatMap(({ edges }) => edges.flatMap((edge) => [edge - NUDGE, edge, edge + NUDGE]));
    const all = [...bearings, ...rays.filter((bearing) => bearing > first && bearing < last)].sort((a, b) => a - b);
    return [[0, 0], ...all.map((bearing) => {
      const x = Math.cos(bearing), y = Math.sin(bearing);
      const far = bodies.reduce((least, body) => Math.min(least, enter(body, x, y)), open(rim, bearings, bearing, x, y));
      return [far * x, far * y];
    })];
  }

  // What hides from agent i, as it lies around it: {x, y, angle, radius, width, height, edges: bearings of its outline}.
  function hiding(description, snapshot, i) {
    const me = snapshot.agents[i], depth = Math.max(...description.agents[i].cone.map(([x, y]) => Math.hypot(x, y)));
    const cosine = Math.cos(me.angle), sine = Math.sin(me.angle);
    const found = [];
    const add = (shape, body) => {
      const x = body.x - me.x, y = body.y - me.y, bound = shape.radius || Math.hypot(shape.width, shape.height) / 2;
      if (Math.hypot(x, y) > depth + bound) return;
      const here = { ...shape, x: x * cosine + y * sine, y: y * cosine - x * sine, angle: (body.angle || 0) - me.angle };
      if (!holds(here)) found.push({ ...here, edges: edges(here) });
    };
    description.agents.forEach((shape, k) => { if (shape.hides && k !== i && snapshot.agents[k].alive) add(shape, snapshot.agents[k]); });
    description.objects.forEach((shape, j) => { if (shape.hides && snapshot.objects[j].here) add(shape, snapshot.objects[j]); });
    return found;
  }

  // The origin in the axes of a body.
  function origin({ x, y, angle }) {
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    return [-x * cosine - y * sine, x * sine - y * cosine];
  }

  // Whether the eye is in it: then it hides nothing.
  function holds(body) {
    const [x, y] = origin(body);
    return body.radius > 0 ? Math.hypot(x, y) <= body.radius : sides(body).every(([a, b, far]) => a * x + b * y <= far);
  }

  // The outer normal of each side of a rectangle or polygon, and how far the side is from its middle.
  function sides(body) {
    const corners = Brush.cornersOf(body);
    return corners.map(([a, b], k) => {
      const [c, d] = corners[(k + 1) % corners.length], length = Math.hypot(c - a, d - b);
      return [(d - b) / length, (a - c) / length, (a * d - b * c) / length];
    });
  }

  function edges(body) {
    const { x, y, angle, radius } = body, middle = Math.atan2(y, x);
    if (radius > 0) {
      const half = Math.asin(Math.min(1, radius / Math.hypot(x, y)));
      return [middle - half, middle, middle + half].map(wrapped);
    }
    const cosine = Math.cos(angle), sine = Math.sin(angle);
    return Brush.cornersOf(body)
      .map(([a, b]) => Math.atan2(y + a * sine + b * cosine, x + a * cosine - b * sine));
  }

  const wrapped = (bearing) => Math.atan2(Math.sin(bearing), Math.cos(bearing));

  // How far away a ray in direction (dx, dy) enters a body.
  function enter(body, dx, dy) {
    const { x, y, angle, radius } = body;
    if (radius > 0) {
      const along = x * dx + y * dy, rest = radius ** 2 - (x * dy - y * dx) ** 2;
      return rest < 0 || along < 0 ? Infinity : along - Math.sqrt(rest);
    }
    const [a, b] = origin(body), cosine = Math.cos(angle), sine = Math.sin(angle);
    const ahead = dx * cosine + dy * sine, aside = dy * cosine - dx * sine;
    let start = -Infinity, end = Infinity;
    for (const [normalX, normalY, middle] of sides(body)) {
      const left = middle - normalX * a - normalY * b, speed = normalX * ahead + normalY * aside;
      if (speed < 0) start = Math.max(start, left / speed);
      else if (speed > 0) end = Math.min(end, left / speed);
      else if (left < 0) return Infinity;
    }
    return start >= 0 && start <= end ? start : Infinity;
  }

  // How far the cone reaches where nothing hides.
  function open(rim, bearings, bearing, dx, dy) {
    const next = bearings.findIndex((other) => other > bearing), k = next < 0 ? rim.length - 1 : Math.max(1, next);
    const [[x, y], [toX, toY]] = [rim[k - 1], rim[k]];
    return (x * (toY - y) - y * (toX - x)) / (dx * (toY - y) - dy * (toX - x));
  }

  return { cone, enter };
})();
