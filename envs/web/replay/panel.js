// Panel: a card for every agent with its health, its bag and what it has done. Works from snapshots, live or recorded.
const Panel = (() => {
  // An element; text goes in as text, whatever it holds.
  function make(tag, name, parent, text) {
    const element = document.createElement(tag);
    if (name) element.className = name;
    if (text !== undefined) element.textContent = text;
    if (parent) parent.append(element);
    return element;
  }

  function write(element, text) {
    if (element.textContent !== String(text)) element.textContent = text;
  }

  const plain = (kind) => kind.replaceAll("_", " ");
  const named = (thing) => thing.role === "box_item" ? "box" : plain(thing.kind);

  // The small sign of an item, as an element.
  function sign(description, thing, owner, parent) {
    const item = description.things[thing];
    const element = make("i", `sign ${item.role}`, parent);
    if (item.role === "box_item") {
      element.style.setProperty("--tint", owner < 0 ? "var(--box)" : description.sides[owner].box);
    }
    if (item.role === "item") element.textContent = item.kind[0];
    element.title = item.role === "heal" ? `heal, ${item.amount} points` : named(item);
    return element;
  }

  // Fills `root` with cards; onFollow(i) is called when one is chosen. Returns update(snapshot, follow, tallies), where
  // tallies (may be missing) holds for each agent {fate, kills, heals, placed, broken}.
  function build(root, description, onFollow) {
    root.replaceChildren();
    const groups = description.teams ? description.sides.map((_, s) => team(root, description, s)) : [];
    const cards = description.agents.map(({ side }, i) => {
      const card = agent(groups[side]?.list || root, description, i);
      card.button.addEventListener("click", () => onFollow(i));
      return card;
    });
    root.classList.toggle("many", cards.length > 8);
    return (snapshot, follow, tallies = []) => {
      cards.forEach((card, i) => show(card, description, snapshot, i, follow === i, tallies[i]));
      groups.forEach((group, s) => {
        const members = snapshot.agents.filter((_, i) => description.agents[i].side === s);
        write(group.count, `${members.filter(({ alive }) => alive).length} of ${members.length} alive`);
      });
    };
  }

  function team(root, { sides }, s) {
    const section = make("section", "team", root);
    section.style.setProperty("--side", sides[s].color);
    const heading = make("h3", "", section);
    make("span", "", heading, `Team ${s}`);
    const count = make("small", "", heading);
    return { list: section, count };
  }

  function agent(root, { agents, sides, slots }, i) {
    const button = make("button", "agent", root);
    button.type = "button";
    button.dataset.agent = i;
    button.style.setProperty("--side", sides[agents[i].side].color);
    button.style.setProperty("--on-side", sides[agents[i].side].ink);
    make("span", "badge", button, i);
    const fate = make("span", "fate", button);
    const points = make("span", "points", button);
    const meter = make("span", "meter", button);
    const fill = make("i", "", meter), beyond = make("i", "beyond", meter);
    const bag = make("span", "bag", button);
    const slot = Array.from({ length: slots }, () => make("span", "slot", bag));
    const deeds = make("span", "deeds", button);
    return { button, fate, points, fill, beyond, bag, slot, deeds, held: null };
  }

  function show(card, description, snapshot, i, followed, tally) {
    const { alive, health, bag } = snapshot.agents[i];
    const share = alive && description.health ? health / description.health : 0;
    card.button.classList.toggle("dead", !alive);
    card.button.setAttribute("aria-pressed", followed);
    write(card.fate, alive ? (followed ? "following" : "alive") : tally?.fate || "dead");
    write(card.points, alive ? health : 0);
    card.fill.style.width = `${100 * Math.min(Math.max(share, 0), 1)}%`;
    card.fill.className = share > 0.5 ? "whole" : share > 0.25 ? "hurt" : "dying";
    card.beyond.style.width = `${100 * Math.min(Math.max(share - 1, 0), 1)}%`;
    write(card.deeds, tally ? deeds(tally) : "");
    const held = bag.map((thing) => `${thing}/${snapshot.things[thing].owner}`).join(" ");
    if (card.held !== held) fill(card, description, snapshot, bag);
    card.held = held;
    const carries = bag.map((thing) => named(description.things[thing])).join(", ") || "nothing";
    card.button.setAttribute("aria-label", `Agent ${i}: ${alive ? `${health} hit points, carries ${carries}` : "dead"}`);
  }

  function fill(card, description, snapshot, bag) {
    card.slot.forEach((slot, k) => {
      slot.replaceChildren();
      if (k < bag.length) sign(description, bag[k], snapshot.things[bag[k]].owner, slot);
    });
  }

  function deeds({ kills, heals, placed, broken }) {
    const parts = [[kills, "kill"], [heals, "heal"], [placed, "placed"], [broken, "broken"]];
    const plural = (count, word) => `${count} ${word}${count > 1 && "kill heal".includes(word) ? "s" : ""}`;
    return parts.filter(([count]) => count).map(([count, word]) => plural(count, word)).join(" · ");
  }

  return { build, make, write, named };
})();
