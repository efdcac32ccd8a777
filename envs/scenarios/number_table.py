"""All that is declared of a number: value, default, range, unit and meaning; for the command and the docs."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, NamedTuple

from outlast.ecs import Module

from .scenario import Scenario


class NumberRow(NamedTuple):
    """A number of a mechanic, in words.

    Attributes:
        name: Its name, as for `Scenario.replace`.
        value: Its value in the scenario; if worlds or agents differ in it, what it is drawn from, and by which role.
        default: Its default in the mechanic.
        allowed: Its range, or its choices.
        unit: Its unit in words; "" if it has none, or none is declared.
        about: Description; "" if its declaration has none.
    """

    name: str
    value: str
    default: str
    allowed: str
    unit: str
    about: str


def scenario_rows(scenario: Scenario) -> list[NumberRow]:
    """Return the numbers of a scenario, by mechanics."""
    differing = {name: str(drawn) for name, drawn in scenario.varied}
    roles = scenario.by_role.roles if scenario.by_role else ()
    for name in scenario.by_role.numbers if scenario.by_role else ():
        values = [(each.name, dict(each.numbers).get(name, scenario.numbers()[name])) for each in roles]
        differing[name] = ", ".join(f"{role} {in_words(value)}" for role, value in values)
    rows = [row for module in scenario.modules for row in number_rows(module)]
    return [row._replace(value=differing.get(row.name, row.value)) for row in rows]


def number_rows(module: Module) -> list[NumberRow]:
    """Return the numbers of a mechanic, in the order of their declaration."""
    return [
        NumberRow(
            f"{module.name}_{item.name}",
            in_words(getattr(module, item.name)),
            in_words(item.default),
            allowed(item.default, item.metadata),
            item.metadata.get("unit", ""),
            item.metadata.get("about", ""),
        )
        for item in fields(module)
    ]


def in_words(value: Any) -> str:
    """Return a number as it can be typed, rounded to six digits."""
    if isinstance(value, tuple):
        return ",".join(map(in_words, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


def allowed(default: Any, rule: Mapping[str, Any]) -> str:
    """Return which values a number may have: "0 to 100000", "above 0", "masked, revealed"."""
    if choices := rule.get("choices"):
        return ", ".join(choices)
    if isinstance(default, bool):
        return "true, false"
    ends = (rule.get(key, math.inf) for key in ("low", "above", "high"))  # infinite without a bound
    low, above, high = (f"{end:.10g}" if math.isfinite(end) else "" for end in ends)
    if above:
        text = f"above {above}" + (f", up to {high}" if high else "")
    else:
        text = f"{low} to {high}" if low and high else f"at least {low}" if low else f"up to {high}" if high else ""
    return f"each {text}" if isinstance(default, tuple) and text else text
