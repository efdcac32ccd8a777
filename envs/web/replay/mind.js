// Mind: what the followed agent does and is paid, and, where the recording has it, what its policy thought.
const Mind = (() => {
  const { make, write } = Dom;
  const MOST = 4, LEAST = 0.01, MANY = 12; // entities listed; share from which on; values of an action drawn one by one

  const signed = (value, plus) => `${value > 0 && plus ? "+" : ""}${value}`.replace("-", "−");
  const rounded = (value) => (Number.isFinite(value) ? signed(+value.toFixed(Math.abs(value) < 10 ? 3 : 1), true) : "–");

  // Fills `root`. Returns update(episode, i, k): agent i after row k; -1: nobody, nothing is shown.
  function build(root) {
    const heading = make("h2", "", root), facts = make("dl", "facts", root), acts = make("div", "acts", root);
    const note = make("p", "note", root), attends = make("div", "attends", root);
    const numbers = ["Reward", "Return", "Value"].map((name) => fact(facts, name));
    numbers[2].title = "The critic's estimate of the discounted rewards to come, in the units that it was trained in";
    let shown = null;

    return (episode, i, k) => {
      root.hidden = i < 0 || i >= episode.description.agents.length;
      if (root.hidden || (shown && shown[0] === episode && shown[1] === i && shown[2] === k)) return;
      shown = [episode, i, k];
      const { description, start } = episode, thought = episode.thought(i, k), chosen = episode.action(i, k);
      write(heading, `Agent ${i}`);
      pay(numbers, episode, i, k, thought);
      numbers[1].title = start ? `Since tick ${start}, the first one here` : "";
      acts.replaceChildren();
      description.actions.forEach((action, n) => act(acts, action, chosen && chosen[n], thought && thought.likely[n]));
      write(note, words(episode, i, k, thought));
      note.hidden = !note.textContent;
      attends.replaceChildren();
      const most = thought ? thought.attends.filter(({ share }) => share >= LEAST).sort((a, b) => b.share - a.share) : [];
      most.slice(0, MOST).forEach((entry) => bar(attends, named(entry, description), entry.share));
    };
  }

  function fact(parent, name) {
    const cell = make("div", "", parent);
    make("dt", "", cell, name);
    return make("b", "", make("dd", "", cell));
  }

  function pay([reward, sum, value], episode, i, k, thought) {
    const paid = episode.description.rewards;
    reward.closest("div").hidden = sum.closest("div").hidden = !paid;
    if (paid) write(reward, rounded(episode.history("agent.reward", i)[k]));
    if (paid) write(sum, rounded(episode.returns()[i][k]) + episode.since);
    value.closest("div").hidden = !thought || Number.isNaN(thought.value);
    if (thought) write(value, rounded(thought.value));
  }

  function words(episode, i, k, thought) {
    if (!episode.action(i, k)) return episode.start + k ? "It is dead, and does nothing." : "The episode is about to begin.";
    return episode.description.entities && !thought ? "It is not played by the policy that was recorded." : "";
  }

  // A row of segments, one for each value: as wide as it is likely, or if that is unknown, all of them alike.
  function act(parent, { name, low, high }, chosen, likely) {
    const row = make("div", "act", parent), values = Array.from({ length: high - low + 1 }, (_, n) => low + n);
    row.dataset.action = name;
    make("span", "name", row, name.replaceAll("_", " "));
    const bar = make("span", "values", row), text = signed(chosen ?? 0, low < 0);
    row.dataset.chosen = chosen ?? "";
    row.setAttribute("aria-label", `${name}: ${chosen === null ? "nothing" : text}`);
    if (values.length > MANY) {
      make("span", "value chosen", bar, chosen === null ? "" : text);
      return;
    }
    values.forEach((value, n) => {
      const share = likely ? likely[n] : 1 / values.length, part = make("span", "value", bar);
      part.classList.toggle("chosen", value === chosen);
      part.style.flexGrow = Math.max(share, 0.001);
      part.title = likely ? `${signed(value, low < 0)}: ${Math.round(100 * share)} %` : signed(value, low < 0);
      if (share > 0.11) part.textContent = signed(value, low < 0);
    });
  }

  function bar(parent, name, share) {
    const row = make("div", "act", parent);
    make("span", "name", row, name);
    const fill = make("i", "", make("span", "share", row));
    fill.style.width = `${100 * share}%`;
    make("span", "percent", row, `${Math.round(100 * share)} %`);
  }

  function named({ key, row, body }, { agents, objects }) {
    if (body < 0) return `${key.replaceAll("_", " ")} ${row}`;
    return body < agents.length ? `agent ${body}` : `${Panel.named(objects[body - agents.length])} ${row}`;
  }

  return { build };
})();
