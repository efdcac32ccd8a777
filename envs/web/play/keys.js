// Keys and touch: what the person holds down, and what was just tapped, as actions by name (see game.py).
const Keys = (() => {
  const BINDINGS = [ // action, value, keys by their place on the keyboard, what it does
    ["ahead", 1, ["KeyW", "ArrowUp"], "forward"],
    ["ahead", -1, ["KeyS", "ArrowDown"], "back"],
    ["left", 1, ["KeyA"], "to the left"],
    ["left", -1, ["KeyD"], "to the right"],
    ["turn", 1, ["KeyQ", "ArrowLeft"], "turn left"],
    ["turn", -1, ["KeyE", "ArrowRight"], "turn right"],
    ["attack", 1, ["Space"], "attack"],
    ["use", 1, ["KeyF"], "use item"],
    ["give", 1, ["KeyG"], "give item"],
    ["drop", 1, ["KeyX"], "drop item"],
  ];
  const DIGITS = 9;
  const ARROWS = { ArrowUp: "↑", ArrowDown: "↓", ArrowLeft: "←", ArrowRight: "→" };
  const ONCE = new Set(["use", "give", "drop"]); // one item for a press, however long it is
  const TOUCH = { turn: ["⟲", "⟳"], attack: ["Strike"], use: ["Use"], give: ["Give"], drop: ["Drop"] };

  let bindings = [];
  let missing = []; // what has no key, in words
  let layout = new Map(); // the letter on each key, where the browser tells
  let ranges = {}; // least and most of each action
  let onChange = () => {};
  const down = new Map(); // of each key, button or stick: {action: value}

  // Find out what is printed on the keys; without that they are called as on a QWERTY keyboard.
  async function learn() {
    if (navigator.keyboard?.getLayoutMap) layout = await navigator.keyboard.getLayoutMap().catch(() => layout);
  }

  const label = (code) => ARROWS[code] || (layout.get(code) || code.replace(/^(Key|Digit)/, "")).replace(/^.$/, (letter) => letter.toUpperCase());

  // Bind the actions that this world has. Those of other mechanics get the digits, one for each value but 0; if there are too
  // few, for each end of their range that is not 0. listener(held, tapped) is called after changes.
  function bind(actions, listener) {
    ranges = actions;
    const known = new Set(BINDINGS.map(([name]) => name));
    const own = Object.keys(actions).filter((name) => !known.has(name));
    const values = ([low, high]) => { // of what goes both ways, the positive ones first
      const from = Array.from({ length: high - low + 1 }, (_, k) => low + k).filter((value) => value);
      return low < 0 ? from.reverse() : from;
    };
    const all = own.flatMap((name) => values(actions[name]).map((value) => [name, value]));
    const ends = all.filter(([name, value]) => actions[name].includes(value));
    const chosen = (all.length > DIGITS ? ends : all).slice(0, DIGITS), keys = new Set(chosen.map(String));
    missing = own.flatMap((name) => {
      const left = all.filter((pair) => pair[0] === name && !keys.has(String(pair)));
      return left.length ? [`${spaced(name)} ${left.map(([, value]) => written(name, value)).join(", ")}`.trim()] : [];
    });
    bindings = [
      ...BINDINGS.filter(([name]) => name in actions).map(([name, value, ...rest]) => [name, full(name, value), ...rest]),
      ...chosen.map(([name, value], k) => [name, value, [`Digit${k + 1}`], `${spaced(name)} ${written(name, value)}`.trim()]),
    ];
    onChange = listener;
  }

  const spaced = (name) => name.replaceAll("_", " ");

  // A value of an action; nothing for one that is done or not.
  function written(name, value) {
    const [low, high] = ranges[name];
    if (high - low === 1) return "";
    return (low < 0 && value > 0 ? "+" : "") + String(value).replace("-", "−");
  }

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
    const rows = [...bindings.map(([, , codes, what]) => [codes.map(label), what]), ...more];
    if (missing.length) rows.push([[], `No key: ${missing.join("; ")}`]);
    list.replaceChildren();
    for (const [keys, what] of rows) {
      const term = Dom.make("dt", "", list);
      keys.forEach((key) => Dom.make("kbd", "", term, key));
      Dom.make("dd", "", list, what);
    }
  }

  // Buttons for all that the stick does not do.
  function buttons(parent) {
    const wanted = bindings.filter(([name]) => name !== "ahead" && name !== "left");
    parent.replaceChildren();
    for (const [name, value, , what] of wanted) {
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

  return { learn, bind, keydown, keyup, releaseAll, explain, buttons, stick };
})();
