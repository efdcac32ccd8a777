// What one agent sees of the world.
const Visible = (() => {
  // A snapshot without what agent `me` does not see: other agents, objects but walls, and others' bags. Strikes of those
  // it sees are left in, though observations do not contain them.
  function to(me, description, snapshot) {
    const watcher = snapshot.agents[me], count = snapshot.agents.length;
    const seen = (k) => k === me || !watcher.sees || watcher.sees.includes(k);
    return {
      ...snapshot,
      agents: snapshot.agents.map((agent, i) => (i === me ? agent : { ...agent, alive: agent.alive && seen(i), bag: [] })),
      objects: snapshot.objects.map((object, j) =>
        description.objects[j].role === "wall" || seen(count + j) ? object : { ...object, here: false }),
    };
  }

  return { to };
})();
