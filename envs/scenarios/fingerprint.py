"""What identifies a game: a scenario's name and numbers, as files keep them to be compared."""

import json
from typing import Any

from .renamed import NUMBERS, current
from .scenario import Scenario

LONGEST = 200  # characters of a name


def fingerprint(scenario: Scenario) -> dict[str, Any]:
    """Name and numbers of a scenario as JSON has them; the name without what cannot be shown in a line."""
    numbers: dict[str, Any] = json.loads(json.dumps(scenario.numbers()))
    name = "".join(letter if letter.isprintable() else "?" for letter in scenario.name[:LONGEST])
    return {"name": name, "numbers": numbers}


def is_fingerprint(given: Any) -> bool:
    """Whether it could be one: a name, and by name numbers, booleans, choices and lists of numbers."""
    if not isinstance(given, dict) or not isinstance(given.get("numbers"), dict):
        return False
    values = [given.get("name"), *given["numbers"], *given["numbers"].values()]
    return is_word(values[0]) and all(map(_is_plain, values[1:]))


def _is_plain(given: Any) -> bool:
    return all(isinstance(each, (int, float)) for each in (given if isinstance(given, list) else [given])) or is_word(
        given
    )


def is_word(given: Any) -> bool:
    """Whether it is a text that can be shown in a line."""
    return isinstance(given, str) and len(given) <= LONGEST and given.isprintable()


def difference(given: Any, own: dict[str, Any]) -> str:
    """Name of the scenario of that fingerprint and the first number that differs from one's own; empty if none does."""
    if not is_fingerprint(given):
        return "(it does not name one)"
    numbers = current(given["numbers"], NUMBERS, own["numbers"])
    for key in sorted(own["numbers"].keys() | numbers.keys()):
        mine, its = own["numbers"].get(key, "not there"), numbers.get(key, "not there")
        if mine != its:
            return f"({given['name']!r}): {key} is {its} there and {mine} here"
    return ""
