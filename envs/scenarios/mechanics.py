"""Mechanics as files name them: full names of classes, and numbers. Nothing that a file names is imported."""

import dataclasses
import functools
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from outlast import systems
from outlast.ecs import Module
from outlast.ecs.checks.code_hash import full_name
from outlast.systems import hide_and_seek

from ..errors import ScenarioError

KNOWN: dict[str, type[Module]] = {
    full_name(kind): kind
    for package in (systems, hide_and_seek)
    for kind in (getattr(package, name) for name in package.__all__)
}


def foreign(names: Iterable[str]) -> list[str]:
    """Return the full names among these that are not classes of outlast's own mechanics."""
    return [name for name in names if name not in KNOWN]


def imported() -> dict[str, type[Module]]:
    """Return all mechanics of this process by full name: outlast's own, and those of the user's that are imported."""
    found: dict[str, type[Module]] = {}
    for kind in Module.imported()[1:]:
        module, before = sys.modules.get(kind.__module__), found.get(full_name(kind))
        if module is not None and (before is None or getattr(module, kind.__name__, None) is not before):
            # if a file was imported several times: the class that is in the module now, or else the last one
            found[full_name(kind)] = kind
    return found | KNOWN


def imported_code(name: str) -> Any:
    """Return the function or class of that full name, if its module is imported; else None. Nothing is imported."""
    parts = name.split(".")
    for k in range(len(parts) - 1, 0, -1):
        found: Any = sys.modules.get(".".join(parts[:k]))
        if found is not None:
            return functools.reduce(lambda within, part: getattr(within, part, None), parts[k:], found)
    return None


def rebuilt_mechanics(names: Iterable[str], numbers: Mapping[str, Any], strict: bool = True) -> tuple[Module, ...]:
    """Make mechanics of these classes, which this process must have, with these numbers.

    Args:
        names: The full names of the classes.
        numbers: Numbers by full name, as in `Scenario.numbers`.
        strict: Whether exactly these numbers must exist. If not, missing numbers get their defaults, and unknown ones,
            which other versions of outlast may have, are ignored.

    Raises:
        ScenarioError: A class was not imported, or a number is missing or unknown.
        NumberError: A value is not allowed.
    """
    left, made, known = dict(numbers), [], imported()
    for name in names:
        if name not in known and name.startswith("__main__."):
            raise ScenarioError(
                f"the mechanic {name.removeprefix('__main__.')} was defined by the script or notebook that saved this; "
                "define it in a file of its own, import it from there, and save again"
            )
        if name not in known:
            raise ScenarioError(
                f"the mechanic {name} is not one of outlast's own, and what a file names is not imported: import it "
                "first, or name what has it, as in --import FILE.py or scenario=..."
            )
        kind = known[name]
        own = {item.name: f"{kind.name}_{item.name}" for item in dataclasses.fields(kind)}
        if strict and (missing := [full for full in own.values() if full not in left]):
            raise ScenarioError(f"the number {missing[0]} is missing; was it made by another version of outlast?")
        made.append(kind(**{item: left.pop(full) for item, full in own.items() if full in left}))
    if strict and left:
        raise ScenarioError(f"unknown number {next(iter(left))}; was it made by another version of outlast?")
    return tuple(made)
