// Address: the part of the page's address behind #, which says what is shown: tick=150&world=3&episode=2&agent=1,
// and of two recordings, which of them these are of: beside=1.
const Address = (() => {
  const NAMES = ["tick", "world", "episode", "agent", "beside"];

  // The numbers in it by name; null if it says nothing.
  function read() {
    const given = new URLSearchParams(location.hash.slice(1)), found = {};
    for (const name of NAMES) if (/^\d{1,15}$/.test(given.get(name) ?? "")) found[name] = Number(given.get(name));
    return Object.keys(found).length ? found : null;
  }

  const text = (values) => `#${NAMES.filter((name) => name in values).map((name) => `${name}=${values[name]}`).join("&")}`;

  function write(values) {
    const hash = text(values);
    if (hash === location.hash) return;
    try {
      history.replaceState(null, "", hash);
    } catch { /* a frame without an address of its own, or too many changes in a short time: the next one will do */ }
  }

  // Copies the address of what is shown. Returns whether that was possible.
  async function copy(values) {
    write(values);
    try {
      await navigator.clipboard.writeText(location.href.replace(/#.*/, "") + text(values));
      return true;
    } catch {
      return false;
    }
  }

  // Where an address leads in a recording: {w, e, at, missing: in words what of it is not there}.
  function find({ worlds }, { tick, world, episode }) {
    const w = world === undefined ? 0 : worlds.findIndex((each) => each.world === world);
    if (w < 0) return { w: 0, e: 0, at: 0, missing: `world ${world}` };
    const { episodes } = worlds[w], holds = ({ start, length }) => tick === undefined || (tick >= start && tick < start + length);
    const e = episodes.findIndex((each) => (episode === undefined || each.number === episode) && holds(each));
    if (e < 0) return { w, e: 0, at: 0, missing: [[episode, "episode"], [tick, "tick"]]
      .filter(([number]) => number !== undefined).map(([number, name]) => `${name} ${number}`).join(", ") };
    return { w, e, at: tick === undefined ? 0 : tick - episodes[e].start, missing: "" };
  }

  return { read, write, copy, find };
})();
