"""Scenarios as names: which classes of mechanics one has, one made anew from such names, and how large it would be."""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from outlast import systems
from outlast.ecs import Layout, Module

from ..errors import ScenarioError
from .renamed import CLASSES, current_numbers
from .scenario import Scenario

KNOWN: dict[str, type[Module]] = {
    f"{kind.__module__}.{kind.__qualname__}": kind for kind in (getattr(systems, name) for name in systems.__all__)
}

MOST = {  # of what a file asks for; larger numbers would go on for very long, and could not be stopped
    "physics_substeps": 1000,
    "physics_velocity_iterations": 10_000,
    "physics_position_iterations": 10_000,
}
LONGEST = 2**16  # of a dimension: entities of a kind, slots of a bag, cells
LARGEST = 2**22  # bytes of the state of one world


def classes(scenario: Scenario) -> list[str]:
    """The full names of the classes of its modules, in order."""
    return current_classes(f"{type(module).__module__}.{type(module).__qualname__}" for module in scenario.modules)


def current_classes(names: Iterable[str]) -> list[str]:
    """The same classes by their current names, in order."""
    return sorted(CLASSES.get(name, name) for name in names)


def rebuilt(fingerprint: dict[str, Any], names: list[str]) -> Scenario:
    """The scenario of that fingerprint and those classes, all of them outlast's own.

    Nothing is imported by name. Raises ScenarioError, and NumberError for numbers that cannot be.
    """
    names, numbers = current_classes(names), current_numbers(fingerprint["numbers"])
    if foreign := [name for name in names if name not in KNOWN]:
        raise ScenarioError(
            f"the mechanic {foreign[0]} is not one of outlast's own, and what a file names is not imported: "
            "give the scenario, as in Recording.open(path, scenario=...)"
        )
    kinds = [KNOWN[name] for name in names]
    check_repetitions(numbers)
    modules = []
    for kind in kinds:
        own = {item.name: f"{kind.name}_{item.name}" for item in dataclasses.fields(kind)}
        if missing := [full for full in own.values() if full not in numbers]:
            raise ScenarioError(f"the number {missing[0]} is missing; was it made by another version of outlast?")
        modules.append(kind(**{name: numbers.pop(full) for name, full in own.items()}))
    if numbers:
        raise ScenarioError(f"there is no number {next(iter(numbers))}; was it made by another version of outlast?")
    return Scenario(str(fingerprint["name"]), tuple(modules), order=tuple(map(tuple, fingerprint.get("order", ()))))


def check_repetitions(numbers: dict[str, Any]) -> None:
    """ScenarioError for numbers of a file by which a tick would go on for very long."""
    for name, most in MOST.items():
        if isinstance(numbers.get(name), int) and numbers[name] > most:
            raise ScenarioError(f"{name} is {numbers[name]}: of a file, at most {most} is accepted")


class _Plan(Layout):
    """A layout without the bytes of a world, to know their number before they are there."""

    def _template(self) -> np.ndarray[Any, Any]:
        return np.zeros(0, np.uint8)


def planned(scenario: Scenario) -> tuple[int, int]:
    """Agents in a world, and bytes that a world takes; next to nothing is allocated to know it.

    Raises ScenarioError if a world is absurdly large or has no agents, and what Layout raises.
    """
    for module in scenario.modules:
        for dim, size in module.dims().items():
            if isinstance(size, int) and size > LONGEST:
                raise ScenarioError(f"it would have {size} {dim}: at most {LONGEST} is possible")
    layout = _Plan(scenario.modules)
    if "agents" not in layout.dims:
        raise ScenarioError("it has no agents")
    if layout.world_bytes > LARGEST:
        raise ScenarioError(f"a world would have {layout.world_bytes} bytes of state: at most {LARGEST} is possible")
    beside = [math.prod(p.shape) * p.component.columns[p.name].dtype.itemsize for p in layout.places if p.offset < 0]
    return layout.dims["agents"], layout.world_bytes + sum(beside)
