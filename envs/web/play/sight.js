"use strict";
// What one agent sees, and the dark around it.
const Sight = (() => {
  const NIGHT = "rgba(16, 18, 26, 0.45)";
  const CLEAR = 1.3; // metres

  // A snapshot without what agent `me` does not see: others, things but walls, and others' bags. Of those it sees it
  // shows the blows too, which the observation does not tell.
  function of(description, snapshot, me) {
    const watcher = snapshot.agents[me], count = snapshot.agents.length;
    const seen = (k) => k === me || !watcher.sees || watcher.sees.includes(k);
    return {
      ...snapshot,
      agents: snapshot.agents.map((agent, i) => (i === me ? agent : { ...agent, alive: agent.alive && seen(i), bag: [] })),
      things: snapshot.things.map((thing, j) =>
        description.things[j].role === "wall" || seen(count + j) ? thing : { ...thing, here: false }),
    };
  }

  // Darken the room outside of the cone of `agent`; a disc around the agent itself stays clear.
  function dim(context, description, agent, { width, height, ratio, camera }) {
    if (!description.cone) return;
    const unit = ratio * Math.min(width, height) / (2 * camera.half);
    const { fov, depth, kind } = description.cone, half = (description.room || 2 * description.half) / 2;
    const edge = (bearing) => [agent.x + depth * Math.cos(agent.angle + bearing), agent.y + depth * Math.sin(agent.angle + bearing)];
    context.save();
    context.setTransform(unit, 0, 0, -unit, ratio * width / 2 - unit * camera.x, ratio * height / 2 + unit * camera.y);
    context.clip(outside(half, (path) => {
      path.moveTo(agent.x, agent.y);
      if (kind === "sector") path.arc(agent.x, agent.y, depth, agent.angle - fov / 2, agent.angle + fov / 2);
      else [-fov / 2, 0, fov / 2].forEach((bearing) => path.lineTo(...edge(bearing)));
      path.closePath();
    }), "evenodd");
    context.clip(outside(half, (path) => path.arc(agent.x, agent.y, CLEAR, 0, 2 * Math.PI)), "evenodd");
    context.fillStyle = NIGHT;
    context.fillRect(-half, -half, 2 * half, 2 * half);
    context.restore();
  }

  // All but what draw(path) encloses.
  function outside(half, draw) {
    const path = new Path2D(), far = 100 * half;
    path.rect(-far, -far, 2 * far, 2 * far);
    draw(path);
    return path;
  }

  return { of, dim };
})();
