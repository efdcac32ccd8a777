// Panel: a card for every agent with its health, its bag and what it has done. Works from snapshots, live or recorded.
const Panel = (() => {
  const { make, write } = Dom;

  const plain = (kind) => kind.replaceAll("_", " ");
  const named = (object) => object.role === "box_item" ? "box" : plain(object.kind);

  // The small sign of an item, as an element.
  function sign(description, j, owner, parent) {
    const item = description.objects[j];
    const element = make("i", `sign ${item.role}`, parent);
    if (item.role === "box_item") {
      element.style.setProperty("--tint", owner < 0 ? "var(--box)" : description.sides[owner].box);
    }
    if (item.role === "item") element.textContent = item.kind[0];
    element.title = item.role === "heal" ? `heal, ${item.amount} points` : named(item);
    return element;
  }

  // Fills `root` with cards; onFollow(i) is called when one is chosen. Returns update(snapshot, follow, tallies), where
  // tallies (may be missing) holds for each agent {since, status, kills, heals, placed, broken}.
  function build(root, description, onFollow) {
    root.replaceChildren();
    const teams = description.teams ? description.sides.map((_, s) => addTeam(root, description, s)) : [];
    const cards = description.agents.map(({ side }, i) => {
      if (side < 0) return null; // absent
      const card = addAgent(teams[side]?.list || root, description, i);
      for (const part of [card.points, card.meter]) part.hidden = !description.agents[i].health;
      card.bag.hidden = !description.slots;
      card.button.addEventListener("click", () => onFollow(i));
      return card;
    });
    root.classList.toggle("many", cards.length > 8);
    return (snapshot, follow, tallies = []) => {
      cards.forEach((card, i) => card && show(card, description, snapshot, i, follow === i, tallies[i]));
      teams.forEach((team, s) => {
        const members = snapshot.agents.filter((_, i) => description.agents[i].side === s);
        if (description.health) write(team.count, `${members.filter(({ alive }) => alive).length} of ${members.length} alive`);
      });
    };
  }

  function addTeam(root, { sides }, s) {
    const section = make("section", "team", root);
    section.style.setProperty("--side", sides[s].color);
    const heading = make("h3", "", section);
    make("span", "", heading, sides[s].name.replace(/^./, (letter) => letter.toUpperCase()));
    const count = make("small", "", heading);
    return { list: section, count };
  }

  function addAgent(root, { agents, sides, slots }, i) {
    const button = make("button", "agent", root);
    button.dataset.agent = i;
    button.style.setProperty("--side", sides[agents[i].side].color);
    button.style.setProperty("--on-side", sides[agents[i].side].ink);
    make("span", "badge", button, i);
    const status = make("span", "status", button);
    const points = make("span", "points", button);
    const meter = make("span", "meter", button);
    const fill = make("i", "", meter), extra = make("i", "extra", meter);
    const bag = make("span", "bag", button);
    const slot = Array.from({ length: slots }, () => make("span", "slot", bag));
    const tally = make("span", "tally", button);
    return { button, status, points, meter, fill, extra, bag, slot, tally, held: null };
  }

  function show(card, description, snapshot, i, followed, tally) {
    const { alive, health, bag } = snapshot.agents[i];
    const whole = description.agents[i].health, share = alive && whole ? health / whole : 0;
    card.button.classList.toggle("dead", !alive);
    card.button.setAttribute("aria-pressed", followed);
    const state = alive ? (followed ? "following" : "alive") : tally?.status || "dead";
    write(card.status, [role(description, i), state].filter(Boolean).join(", "));
    write(card.points, alive ? health : 0);
    card.fill.style.width = `${100 * Math.min(Math.max(share, 0), 1)}%`;
    card.fill.className = Bodies.healthColor(share);
    card.extra.style.width = `${100 * Math.min(Math.max(share - 1, 0), 1)}%`;
    write(card.tally, tally ? summary(tally) : "");
    const held = bag.map((j) => `${j}/${snapshot.objects[j].owner}`).join(" ");
    if (card.held !== held) fill(card, description, snapshot, bag);
    card.held = held;
    const carries = bag.map((j) => named(description.objects[j])).join(", ") || "nothing";
    const has = [whole ? `${health} hit points` : "", description.slots ? `carries ${carries}` : ""].filter(Boolean).join(", ");
    card.button.setAttribute("aria-label", `Agent ${i}: ${alive ? has || "alive" : "dead"}`);
  }

  // An agent's role, unless its team is called so.
  function role({ agents, sides }, i) {
    return agents[i].role === sides[agents[i].side].name ? "" : agents[i].role;
  }

  function fill(card, description, snapshot, bag) {
    card.slot.forEach((slot, k) => {
      slot.replaceChildren();
      if (k < bag.length) sign(description, bag[k], snapshot.objects[bag[k]].owner, slot);
    });
  }

  function summary({ since, kills, heals, placed, broken }) {
    const parts = [[kills, "kill"], [heals, "heal"], [placed, "placed"], [broken, "broken"]];
    const plural = (count, word) => `${count} ${word}${count > 1 && "kill heal".includes(word) ? "s" : ""}`;
    const done = parts.filter(([count]) => count).map(([count, word]) => plural(count, word)).join(" · ");
    return done && done + since;
  }

  return { build, named };
})();
