// Views: what is shown and what is not, as buttons and keys; and the list of all keys.
const Views = (() => {
  const ALL = [
    ["cones", "v", "Cones", "vision cones"],
    ["lines", "l", "Lines of sight", "a line to everybody who is seen"],
    ["rays", "r", "Rays", "how far agents measure it to be, by lidar"],
    ["zone", "z", "Zone", "the safe zone, and the next one in dashes"],
    ["ids", "i", "Numbers", "numbers of agents"],
    ["health", "h", "Health", "health bars"],
    ["bags", "b", "Bags", "what agents carry"],
    ["trails", "t", "Trails", "where agents came from"],
    ["blind", "x", "As seen", "fade what the followed agent does not see"],
    ["attention", "a", "Attention", "what the policy of the followed agent attends to"],
    ["close", "c", "Close-up", "stay near the followed agent"],
  ];
  const AT_FIRST = ["cones", "zone", "ids", "health", "bags", "attention", "close"];
  const NEEDS = { cones: "cone", lines: "cone", rays: "rays", blind: "cone", zone: "zone", health: "health", bags: "slots", attention: "entities" };

  // Returns {show, toggle(name), fit(descriptions, follow), byKey}; onChange() is called after every change.
  function build(root, onChange) {
    const show = Object.fromEntries(ALL.map(([name]) => [name, AT_FIRST.includes(name)])), buttons = {};
    for (const [name, key, label, about] of ALL) {
      const button = Dom.make("button", "", root, label);
      button.dataset.view = name;
      button.title = about;
      Dom.make("kbd", "", button, key.toUpperCase()).setAttribute("aria-hidden", "true");
      button.addEventListener("click", () => toggle(name));
      buttons[name] = button;
    }

    function toggle(name) {
      if (buttons[name].disabled) return;
      show[name] = !show[name];
      update();
      onChange();
    }

    function update() {
      for (const [name] of ALL) buttons[name].setAttribute("aria-pressed", show[name]);
    }

    // What no recording of the page has cannot be switched.
    function fit(descriptions, follow) {
      const has = (what) => descriptions.some((description) => description[what]);
      for (const [name] of ALL) buttons[name].disabled = name in NEEDS && !has(NEEDS[name]);
      buttons.attention.hidden = !has("entities");
      buttons.rays.hidden = !has("rays");
      for (const name of ["blind", "attention", "close"]) buttons[name].disabled ||= follow < 0;
    }

    update();
    return { show, toggle, fit, byKey: Object.fromEntries(ALL.map(([name, key]) => [key, name])) };
  }

  // Fills a dialog with the list of keys: those of the page, and those of the views.
  function explain(dialog, keys) {
    Dom.make("h2", "", dialog, "Keys");
    const table = Dom.make("table", "", dialog);
    for (const [key, about] of [...keys, ...ALL.map(([, key, , about]) => [key.toUpperCase(), about])]) {
      const row = Dom.make("tr", "", table);
      Dom.make("kbd", "", Dom.make("td", "", row), key);
      Dom.make("td", "", row, about);
    }
    Dom.make("button", "", Dom.make("p", "", dialog), "Close").addEventListener("click", () => dialog.close());
    dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  }

  return { build, explain };
})();
