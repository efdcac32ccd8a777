// Keys and touch: what the person holds down, and what was just tapped, as actions by name (see messages.py).
const Keys = (() => {
  const BINDINGS = [ // action, value, keys by their place on the keyboard, what to call them, what it does
    ["ahead", 1, ["KeyW", "ArrowUp"], "W ↑", "forward"],
    ["ahead", -1, ["KeyS", "ArrowDown"], "S ↓", "back"],
    ["left", 1, ["KeyA"], "A", "to the left"],
    ["left", -1, ["KeyD"], "D", "to the right"],
    ["turn", 1, ["KeyQ", "ArrowLeft"], "Q ←", "turn left"],
    ["turn", -1, ["KeyE", "ArrowRight"], "E →", "turn right"],
    ["attack", 1, ["Space"], "Space", "attack"],
    ["use", 1, ["KeyF"], "F", "use item"],
    ["give", 1, ["KeyG"], "G", "give item"],
    ["drop", 1, ["KeyX"], "X", "drop item"],
  ];
  const ONCE = new Set(["use", "give", "drop"]); // one item for a press, however long it is
  const TOUCH = { turn: ["⟲", "⟳"], attack: ["Strike"], use: ["Use"], give: ["Give"], drop: ["Drop"] };

  let bindings = [];
  let ranges = {}; // least and most of each action
  let onChange = () => {};
  const down = new Map(); // of each key, button or stick: {action: value}

  // Bind the actions that this world has; those of other mechanics get the digits, one for each end of their range that is not 0.
  // listener(held, tapped) is called after changes.
  function bind(actions, listener) {
    ranges = actions;
    const known = new Set(BINDINGS.map(([name]) => name));
    const ends = (name) => {
      const values = actions[name].filter((value) => value).reverse();
      return values.map((value) => [name, value, values.length > 1]);
    };
    const others = Object.keys(actions).filter((name) => !known.has(name)).flatMap(ends).slice(0, 9);
    bindings = [
      ...BINDINGS.filter(([name]) => name in actions).map(([name, value, ...rest]) => [name, full(name, value), ...rest]),
      ...others.map(([name, value, signed], k) => [name, value, [`Digit${k + 1}`], String(k + 1), words(name, signed && value)]),
    ];
    onChange = listener;
  }

  const words = (name, value) => name.replaceAll("_", " ") + (value ? ` ${value < 0 ? "−" : "+"}${Math.abs(value)}` : "");

  const full = (name, sign) => (sign && name in ranges ? ranges[name][sign < 0 ? 0 : 1] : 0);

  function held() {
    const wanted = Object.assign({}, ...down.values()); // of two that contradict each other, the later one
    return Object.fromEntries(Object.entries(wanted).filter(([name, value]) => value && !ONCE.has(name)));
  }

  function press(source, actions) {
    const before = down.get(source) || {};
    down.delete(source);
    down.set(source, actions);
    onChange(held(), Object.fromEntries(Object.entries(actions).filter(([name, value]) => value && before[name] !== value)));
  }

  function release(source) {
    if (down.delete(source)) onChange(held(), {});
  }

  function releaseAll() {
    if (!down.size) return;
    down.clear();
    onChange({}, {});
  }

  // True if the event was one of ours.
  function keydown(event) {
    const binding = bindings.find(([, , codes]) => codes.includes(event.code));
    if (!binding) return false;
    if (!down.has(event.code) && !event.repeat) press(event.code, { [binding[0]]: binding[1] });
    return true;
  }

  const keyup = (event) => release(event.code);

  // Fill a list with the keys and what they do.
  function explain(list, more) {
    const rows = [...bindings.map(([, , , keys, what]) => [keys, what]), ...more];
    list.replaceChildren();
    for (const [keys, what] of rows) {
      const term = Dom.make("dt", "", list);
      keys.split(" ").forEach((key) => Dom.make("kbd", "", term, key));
      Dom.make("dd", "", list, what);
    }
  }

  // Buttons for all that the stick does not do.
  function buttons(parent) {
    const wanted = bindings.filter(([name]) => name !== "ahead" && name !== "left");
    parent.replaceChildren();
    for (const [name, value, , , what] of wanted) {
      const labels = TOUCH[name] || [what], button = Dom.make("button", "", parent, labels[value < 0 ? 1 : 0]);
      button.ariaLabel = what;
      button.dataset.action = name;
      const source = `touch ${name} ${value}`;
      button.addEventListener("pointerdown", (event) => {
        button.setPointerCapture(event.pointerId);
        press(source, { [name]: value });
      });
      for (const end of ["pointerup", "pointercancel"]) button.addEventListener(end, () => release(source));
      button.addEventListener("contextmenu", (event) => event.preventDefault());
    }
  }

  // A stick: up is ahead, as the agent's own directions are.
  function stick(pad) {
    const knob = pad.firstElementChild;
    const move = (event) => {
      const { left, top, width, height } = pad.getBoundingClientRect();
      let x = 2 * (event.clientX - left) / width - 1, y = 1 - 2 * (event.clientY - top) / height;
      const size = Math.hypot(x, y), sign = (value) => (Math.abs(value) > 0.3 ? Math.sign(value) : 0);
      const actions = { ahead: full("ahead", sign(y)), left: full("left", sign(-x)) }, before = down.get("stick") || {};
      if (actions.ahead !== before.ahead || actions.left !== before.left) press("stick", actions);
      if (size > 1) [x, y] = [x / size, y / size];
      knob.style.transform = `translate(${x * width / 4}px, ${-y * height / 4}px)`;
    };
    const end = () => { knob.style.transform = ""; release("stick"); };
    pad.addEventListener("pointerdown", (event) => { pad.setPointerCapture(event.pointerId); move(event); });
    pad.addEventListener("pointermove", (event) => { if (pad.hasPointerCapture(event.pointerId)) move(event); });
    for (const name of ["pointerup", "pointercancel"]) pad.addEventListener(name, end);
  }

  return { bind, keydown, keyup, releaseAll, explain, buttons, stick };
})();
