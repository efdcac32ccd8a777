"""What was changed to derive a scenario: names and sentences that say it, and the numbers that follow others."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from outlast.ecs import Module, NumberError

LONGEST = 60  # characters that a name adds for all changes (a hash stands for the rest), and a sentence for one


def changes(before: Sequence[Module], after: Sequence[Module]) -> list[str]:
    """In words and by name, what is different: "without boxes", "with swamp", "melee_damage=20".

    Args:
        before: Mechanics of a scenario.
        after: Mechanics of one that was derived from it.

    Returns:
        Of new mechanics, the numbers that are unlike their defaults, too. Numbers that only follow others are left out.
    """
    there, here = ({module.slot(): type(module) for module in modules} for modules in (before, after))
    new = [module for module in after if there.get(module.slot()) is not type(module)]
    usual = numbers(before) | {f"{m.name}_{item.name}": item.default for m in new for item in dataclasses.fields(m)}
    now = numbers(after)
    leaders = {item.metadata.get("scales_with") for module in after for item in dataclasses.fields(module)}
    led = following(before, usual, {name: value for name, value in now.items() if name in leaders})
    usual |= {name: value for name, (_, value) in led.items()}
    found = [f"without {module.name}" for module in before if module.slot() not in here]
    found += [f"with {module.name}" for module in new]
    return found + [f"{_short(name)}={shown(value)}" for name, value in now.items() if value != usual[name]]


def by_full_name(find: Callable[[str], tuple[str, str]], given: Mapping[str, Any]) -> dict[str, Any]:
    """What is given for numbers, by their full names ("agents_count").

    Args:
        find: Scenario.find_number.
        given: By any of their names.

    Raises:
        NumberError: An unknown number, or one by two of its names.
    """
    found = {"_".join(find(name)): value for name, value in given.items()}
    if len(found) < len(given):
        raise NumberError(f"{', '.join(given)}: one number is given twice, by two of its names")
    return found


def numbers(modules: Iterable[Module]) -> dict[str, Any]:
    """Every number of these mechanics by its full name, sorted by mechanics."""
    ordered = sorted(modules, key=lambda module: module.name)
    return {f"{m.name}_{item.name}": getattr(m, item.name) for m in ordered for item in dataclasses.fields(m)}


def _short(name: str) -> str:
    """n_agents for agents_count."""
    return f"n_{name.removesuffix('_count')}" if name.endswith("_count") else name


def shown(value: Any) -> str:
    """A number as it is typed behind --set."""
    if isinstance(value, tuple):
        return ",".join(map(shown, value))
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def derived_name(name: str, changed: Sequence[str]) -> str:
    """A scenario's name with its changes, "teams_3-without_boxes-n_agents=6", other ones for other changes."""
    suffix = as_file_name("".join(f"-{each}" for each in changed))
    if len(suffix) > LONGEST:
        suffix = f"{suffix[: LONGEST - 9]}-{hashlib.sha256(suffix.encode()).hexdigest()[:8]}"
    return name + suffix


def derived_about(about: str, changed: Sequence[str]) -> str:
    """A scenario's sentence with its changes."""
    short = [each if len(each) <= LONGEST else f"{each[: LONGEST - 3]}..." for each in changed]
    return "; ".join(filter(None, (about, f"changed: {', '.join(short)}" if changed else "")))


def as_file_name(text: str) -> str:
    """The text with what is not a letter, a digit or one of ._,=+- replaced, so that a file can be called so."""
    return re.sub(r"[^\w.,=+-]", "_", text)


def following(
    modules: Sequence[Module], origin: Mapping[str, Any], given: Mapping[str, Any]
) -> dict[str, tuple[str, Any]]:
    """The numbers that change with those that are given, as they were declared to: see ecs.number's `scales_with`.

    A number follows only while it is what the scenario began with, in proportion; not once it was set by hand.

    Args:
        modules: With the numbers of now.
        origin: All numbers that the scenario began with, by full name.
        given: New numbers by full name.

    Returns:
        By full name, the number that it follows, and its new value.
    """
    now, found = numbers(modules), {}
    for module in modules:
        for item in dataclasses.fields(module):
            name, leader = f"{module.name}_{item.name}", item.metadata.get("scales_with", "")
            if leader not in given or name in given or not {name, leader} <= origin.keys():
                continue
            if now[name] == _scaled(origin[name], origin[leader], now[leader]):
                found[name] = leader, _scaled(origin[name], origin[leader], given[leader])
    return found


def _scaled(value: Any, old: float, new: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled(each, old, new) for each in value)
    return value / old * new  # in this order half of the room stays exactly half of it
