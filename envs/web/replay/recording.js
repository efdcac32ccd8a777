// Recording.open reads what pages.py wrote; an episode then gives back the snapshots of world_json.py, tick by tick.
const Recording = (() => {
  const { metre: METRE, radian: RADIAN, whole: WHOLE, word: WORD } = PACKING;
  const ARRAYS = { 0: Float32Array, 1: Int8Array, 2: Int16Array, 4: Int32Array };
  const STATE = ["zone", ...["alive", "health", "strike", "target", "bag", "sees", "rays"].map((name) => `agent.${name}`),
    ...["here", "owner", "wound"].map((name) => `object.${name}`)];

  const bytes = (width) => ARRAYS[width].BYTES_PER_ELEMENT;

  // The recordings of a page, [{title, worlds: [{world, episodes}]}].
  async function open(base64) {
    const packed = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const buffer = await new Response(stream).arrayBuffer();
    const size = new DataView(buffer).getUint32(0, true);
    const rooms = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
    let at = 4 + size;
    for (const world of rooms.flatMap(({ worlds }) => worlds)) {
      world.episodes = world.episodes.map((header) => {
        const episode = new Episode(header, buffer, at);
        at += header.length * header.columns.reduce((sum, [, count, width]) => sum + count * bytes(width), 0);
        return episode;
      });
    }
    return rooms;
  }

  class Episode {
    constructor(header, buffer, offset) {
      Object.assign(this, header); // description, number, start, length, events, columns
      this.buffer = buffer;
      this.offset = offset;
      this.tables = null;
    }

    // Columns as {values, count}, entry by entry, each over all ticks; unpacked when first needed.
    table(name) {
      if (!this.tables) {
        this.tables = {};
        let at = this.offset;
        for (const [column, count, width] of this.columns) {
          const size = count * bytes(width) * this.length;
          const steps = new ARRAYS[width](this.buffer.slice(at, at + size));
          this.tables[column] = { count, values: width ? summed(steps, this.length) : steps };
          at += size;
        }
      }
      return this.tables[name];
    }

    // What sums and counts are followed by where the page begins within the episode.
    get since() { return this.start ? ` since step ${this.start}` : ""; }

    forget() { this.tables = this.returned = null; }

    // What each agent was paid from the first row to each row: a Float64Array over all ticks for each agent.
    returns() {
      this.returned ||= this.description.agents.map((_, i) => {
        let sum = 0;
        return Float64Array.from(this.history("agent.reward", i), (reward) => { sum += reward; return sum; });
      });
      return this.returned;
    }

    // What agent i was told to do in the tick that led to row k, by number of the action; null: nothing.
    action(i, k) {
      const count = this.description.actions.length, alive = this.history("agent.alive", i);
      const acts = this.start + k > 0 && (alive[Math.max(0, k - 1)] || alive[k]); // who comes back acts in that tick
      return acts ? Array.from({ length: count }, (_, n) => this.history("agent.action", i * count + n)[k]) : null;
    }

    // What the policy of agent i thought ahead of that tick: {value, likely: [[share of each value] of each action],
    // attends: [{key, row, body, share}]}; null: not recorded.
    thought(i, k) {
      const { actions, entities } = this.description;
      if (!entities || !this.action(i, k)) return null;
      const sizes = actions.map(({ low, high }) => high - low + 1), values = sizes.reduce((sum, size) => sum + size, 0);
      const share = (name, n) => this.history(name, n)[k] / WHOLE;
      let at = i * values;
      const likely = sizes.map((size) => Array.from({ length: size }, () => share("agent.likely", at++)));
      if (likely[0]?.[0] < 0) return null; // not an agent of this policy
      const rows = entities.reduce((sum, kind) => sum + kind.rows, 0);
      at = i * rows;
      const attends = entities.flatMap(({ key, rows, others, first }) => Array.from({ length: rows }, (_, row) => {
        const other = row + (row >= i ? 1 : 0);
        return { key, row, body: others ? other : first < 0 ? -1 : first + row, share: share("agent.attends", at++) };
      }));
      return { value: this.history("agent.value", i)[k], likely, attends };
    }

    // The numbers of a column after tick k.
    row(name, k) {
      const { count, values } = this.table(name);
      return Array.from({ length: count }, (_, n) => values[n * this.length + k]);
    }

    // One number of a column over all ticks.
    history(name, n) {
      return this.table(name).values.subarray(n * this.length, (n + 1) * this.length);
    }

    // Where an "agent" or "object" was after tick k.
    place(kind, i, k) {
      const [x, y, angle] = ["x", "y", "angle"].map((name) => this.history(`${kind}.${name}`, i)[k]);
      return { x: x / METRE, y: y / METRE, angle: angle / RADIAN };
    }

    snapshot(k) {
      const { agents, objects, slots, zone, rays, looks } = this.description;
      const get = Object.fromEntries(STATE.map((name) => [name, this.row(name, k)]));
      const words = get["agent.sees"].length / (agents.length || 1);
      return {
        episode: this.number,
        tick: this.start + k,
        rings: looks ? this.row("body.ring", k).map((on) => on === 1) : [],
        lines: looks ? this.row("body.line", k) : [],
        zone: zone ? get.zone.map((length) => length / METRE) : null,
        agents: agents.map((_, i) => ({
          ...this.place("agent", i, k),
          alive: get["agent.alive"][i] === 1,
          health: get["agent.health"][i],
          strike: get["agent.strike"][i],
          target: get["agent.target"][i],
          bag: get["agent.bag"].slice(i * slots, (i + 1) * slots).filter((j) => j >= 0),
          sees: members(get["agent.sees"].slice(i * words, (i + 1) * words)),
          rays: get["agent.rays"].slice(i * rays, (i + 1) * rays).map((length) => length / METRE),
        })),
        objects: objects.map((_, j) => ({
          ...this.place("object", j, k),
          here: get["object.here"][j] === 1,
          owner: get["object.owner"][j],
          wound: get["object.wound"][j],
        })),
      };
    }
  }

  function summed(steps, length) {
    const values = new Int32Array(steps.length);
    for (let n = 0; n < steps.length; n++) values[n] = (n % length ? values[n - 1] : 0) + steps[n];
    return values;
  }

  function members(words) {
    if (words[0] === -1) return null;
    return words.flatMap((word, g) => [...Array(WORD).keys()].filter((j) => word >> j & 1).map((j) => WORD * g + j));
  }

  // Between two snapshots: what is in the world in both has moved by this share of its way; all else is that of the first.
  function blend(one, other, share) {
    const mix = (a, b) => a + share * (b - a);
    const moved = (a, b, both) => both && Math.hypot(b.x - a.x, b.y - a.y) < 1
      ? { ...a, x: mix(a.x, b.x), y: mix(a.y, b.y), angle: mix(a.angle, b.angle) } : a;
    return {
      ...one,
      zone: one.zone && one.zone[2] > 0 && other.zone[2] > 0
        ? one.zone.map((length, n) => n < 3 ? mix(length, other.zone[n]) : length) : one.zone,
      agents: one.agents.map((a, i) => moved(a, other.agents[i], a.alive && other.agents[i].alive)),
      objects: one.objects.map((a, j) => moved(a, other.objects[j], a.here && other.objects[j].here)),
    };
  }

  return { open, blend };
})();
