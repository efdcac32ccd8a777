// Events: those of an episode in words, counted, and as marks in the world.
const Events = (() => {
  const QUIET = new Set(["start", "end", "other"]);
  const CAUSES = { zone: "died outside of the zone" };

  // What an event says, in pieces: strings, and numbers for agents.
  function words({ kind, agent, by, side, cause, object }, description) {
    const who = agent < 0 ? "somebody" : agent, team = description.teams ? description.sides[side]?.name : side;
    const name = object < 0 ? "" : Panel.named(description.objects[object]);
    switch (kind) {
      case "start": return ["the episode starts"];
      case "kill": return [by >= 0 ? by : team, " killed ", agent, cause === "melee" ? "" : ` (${cause})`];
      case "death": return [agent, ` ${CAUSES[cause] || (cause ? `died of ${cause}` : "died")}`];
      case "heal": return [who, ` used a heal, +${description.objects[object].amount}`];
      case "place": return [who, " placed a box"];
      case "use": return [who, ` used ${name}`];
      case "other": return agent < 0 ? [cause] : [agent, ` ${cause}`];
      case "break": return [agent < 0 && side >= 0 ? team : who, " broke a box"];
    }
    if (cause === "rule") return ["the episode ends"];  // several are left: by a rule of the game's own
    return [cause === "truncated" ? "cut off at the limit of time" : ending(side, description)];
  }

  function ending(side, { sides }) {
    if (side < 0) return "the episode ends, nobody is left";
    return `the episode ends, ${sides[side].name} is left`;
  }

  function text(event, description) {
    return words(event, description).map((piece) => typeof piece === "number" ? `agent ${piece}` : piece).join("");
  }

  // The words as elements, agents as discs in their colour.
  function append(parent, event, description) {
    const line = Dom.make("span", "", parent);
    for (const piece of words(event, description)) {
      if (typeof piece !== "number") line.append(piece);
      else badge(line, piece, description);
    }
  }

  function badge(parent, i, { agents, sides }) {
    const element = Dom.make("span", "who", parent, i);
    element.style.setProperty("--side", sides[agents[i].side].color);
    element.style.setProperty("--on-side", sides[agents[i].side].ink);
  }

  // What every agent has done until row k: {since, status, kills, heals, placed, broken}; since: see Episode.
  function tallies({ description, events, start, since }, k) {
    const all = description.agents.map(() => ({ since, status: "", kills: 0, heals: 0, placed: 0, broken: 0 }));
    for (const event of events) {
      if (event.at > k) break;
      const { kind, agent, by, cause } = event, me = all[agent];
      if (kind === "kill" && by >= 0) all[by].kills++;
      if (me && (kind === "kill" || kind === "death")) me.status = death(kind, by, cause, start + event.at);
      if (me && kind === "heal") me.heals++;
      if (me && kind === "place") me.placed++;
      if (me && kind === "break") me.broken++;
    }
    return all;
  }

  function death(kind, by, cause, tick) {
    const how = kind === "kill" ? `killed${by >= 0 ? ` by ${by}` : ""}` : cause === "zone" ? "died outside" : "died";
    return `${how} at ${tick}`;
  }

  // Marks of what happened shortly before `position` (rows, with a fraction): see World.draw. Those of items move with
  // whoever used them, all others stay where it happened.
  function marks(episode, position) {
    const { description, events } = episode, last = Bodies.FADE / description.seconds;
    return events.filter(({ at, kind }) => at <= position && position < at + last && !QUIET.has(kind)).map((event) => {
      const { at, kind, agent, object } = event, box = agent < 0 || kind === "break" || kind === "place";
      const when = kind === "heal" || kind === "use" ? Math.floor(position) : at;
      const place = episode.place(box ? "object" : "agent", box ? object : agent, when);
      return { ...event, ...place, age: (position - at) / last };
    });
  }

  // Where agents came from in the last two seconds: [[[x, y] ...] of each agent].
  function trails(episode, k) {
    const { agents, seconds } = episode.description, from = Math.max(0, k - Math.round(2 / seconds));
    return agents.map((_, i) => {
      if (!episode.history("agent.alive", i)[k]) return [];
      return Array.from({ length: k - from + 1 }, (_, n) => episode.place("agent", i, from + n)).map(({ x, y }) => [x, y]);
    });
  }

  return { text, append, tallies, marks, trails };
})();
