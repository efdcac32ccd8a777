"""Scenarios as names: which classes of mechanics one has, and one made anew from such names."""

import dataclasses
from typing import Any

from outlast import systems
from outlast.ecs import Module

from ..scenario import Scenario, ScenarioError

KNOWN: dict[str, type[Module]] = {
    f"{kind.__module__}.{kind.__qualname__}": kind for kind in (getattr(systems, name) for name in systems.__all__)
}


def classes(scenario: Scenario) -> list[str]:
    """The full names of the classes of its modules, by name of the module."""
    kinds = [type(module) for module in sorted(scenario.modules, key=lambda module: module.name())]
    return [f"{kind.__module__}.{kind.__qualname__}" for kind in kinds]


def rebuilt(identity: dict[str, Any], names: list[str]) -> Scenario:
    """The scenario of that identity (see state.identity) and those classes, all of them outlast's own.

    Nothing is imported by name. Raises ScenarioError, and NumberError for numbers that cannot be.
    """
    if foreign := [name for name in names if name not in KNOWN]:
        raise ScenarioError(
            f"the mechanic {foreign[0]} is not one of outlast's own, and what a file names is not imported: "
            "give the scenario, as in Recording.open(path, scenario=...)"
        )
    kinds, numbers = [KNOWN[name] for name in names], dict(identity["numbers"])
    modules = []
    for kind in kinds:
        own = {item.name: f"{kind.name()}_{item.name}" for item in dataclasses.fields(kind)}
        if missing := [full for full in own.values() if full not in numbers]:
            raise ScenarioError(f"the number {missing[0]} is missing; was it made by another version of outlast?")
        modules.append(kind(**{name: numbers.pop(full) for name, full in own.items()}))
    if numbers:
        raise ScenarioError(f"there is no number {next(iter(numbers))}; was it made by another version of outlast?")
    return Scenario(str(identity["name"]), tuple(modules))
