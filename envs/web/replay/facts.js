// Facts: the numbers of a world above the agents, and the clock.
const Facts = (() => {
  const ROLES = [["heal", "Heals"], ["box", "Boxes"], ["box_item", "Broken"], ["item", "Items"]];
  const { $ } = Dom;

  // Objects in the world by kind, as far as this scenario has them.
  function build({ objects, zone }) {
    $("facts").querySelectorAll("[data-role]").forEach((fact) => fact.closest("div").remove());
    for (const [role, name] of ROLES.filter(([role]) => objects.some((object) => object.role === role))) {
      const fact = Dom.make("div", "", $("facts"));
      Dom.make("dt", "", fact, name);
      Dom.make("b", "", Dom.make("dd", "", fact)).dataset.role = role;
    }
    $("zone").closest("div").hidden = !zone;
  }

  function show({ tick, agents, objects, zone }, { description, start, length }) {
    Dom.write($("tick"), tick);
    Dom.write($("length"), start + length - 1);
    Dom.write($("seconds"), Dom.seconds(tick, description));
    Dom.write($("alive"), agents.filter(({ alive }) => alive).length);
    Dom.write($("agents"), description.agents.filter(({ side }) => side >= 0).length);
    Dom.write($("zone"), zone ? zone[2].toFixed(1) : "–");
    for (const fact of $("facts").querySelectorAll("[data-role]")) {
      Dom.write(fact, objects.filter(({ here }, j) => here && description.objects[j].role === fact.dataset.role).length);
    }
    for (const [name, value] of [["min", start], ["max", start + length - 1], ["now", tick], ["text", `tick ${tick}`]]) {
      $("timeline").setAttribute(`aria-value${name}`, value);
    }
  }

  return { build, show };
})();
