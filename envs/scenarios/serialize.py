"""Scenarios as names: which classes of mechanics one has, one made anew from such names, and how large it would be."""

import dataclasses
import math
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np

from outlast import systems
from outlast.ecs import Distribution, Layout, Module, choice, integers, log_uniform, uniform
from outlast.ecs.identity import full_name
from outlast.ecs.varied import place

from ..errors import ScenarioError
from .renamed import CLASSES, current_numbers
from .scenario import Scenario

KNOWN: dict[str, type[Module]] = {
    full_name(kind): kind for kind in (getattr(systems, name) for name in systems.__all__)
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
    return current_classes(full_name(type(module)) for module in scenario.modules)


def current_classes(names: Iterable[str]) -> list[str]:
    """The same classes by their current names, in order."""
    return sorted(CLASSES.get(name, name) for name in names)


def foreign(names: Iterable[str]) -> list[str]:
    """Those of these full names of classes that are not outlast's own mechanics."""
    return [name for name in current_classes(names) if name not in KNOWN]


def rebuilt(fingerprint: dict[str, Any], names: list[str], strict: bool = True) -> Scenario:
    """The scenario of a fingerprint, of classes that this process has: nothing is imported by name.

    Args:
        fingerprint: Its name, numbers and order.
        names: The full names of the classes of its mechanics.
        strict: Whether all numbers must be there, and no others; else missing ones get their defaults, and unknown
            ones, as of other versions of outlast, are left out.

    Raises:
        ScenarioError: A class was not imported, or a number is missing or unknown.
        NumberError: A number cannot be.
    """
    kinds, numbers = _kinds(current_classes(names)), current_numbers(fingerprint["numbers"])
    check_repetitions(numbers)
    modules = []
    for kind in kinds:
        own = {item.name: f"{kind.name}_{item.name}" for item in dataclasses.fields(kind)}
        if strict and (missing := [full for full in own.values() if full not in numbers]):
            raise ScenarioError(f"the number {missing[0]} is missing; was it made by another version of outlast?")
        modules.append(kind(**{name: numbers.pop(full) for name, full in own.items() if full in numbers}))
    if strict and numbers:
        raise ScenarioError(f"there is no number {next(iter(numbers))}; was it made by another version of outlast?")
    name = str(fingerprint.get("label") or fingerprint["name"])
    made = Scenario(name, tuple(modules), order=tuple(map(tuple, fingerprint.get("order", ()))))
    drawn = {key: _distribution(*entry) for key, entry in fingerprint.get("varied", {}).items()}
    if drawn:
        made = made.vary(**drawn).titled_as(made)
    observed = fingerprint.get("observed", ())
    return made.observe_numbers(*observed).titled_as(made) if observed else made


def _distribution(name: str, *values: Any) -> Distribution:
    """A distribution by its name. NumberError for values that it cannot have."""
    made = {"uniform": uniform, "log_uniform": log_uniform, "integers": integers, "choice": choice}[name]
    found: Distribution = made(*values)
    return found


def _kinds(names: list[str]) -> list[type[Module]]:
    """The mechanics of these full names: outlast's own, and those that are imported. Raises ScenarioError."""
    known = {full_name(kind): kind for kind in Module.imported()[1:] if kind.__module__ in sys.modules} | KNOWN
    for name in names:
        if name not in known:
            raise ScenarioError(
                f"the mechanic {name} is not one of outlast's own, and what a file names is not imported: import it "
                "first, or name the scenario that has it, as in --scenario FILE.py:NAME or scenario=..."
            )
    return [known[name] for name in names]


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
    largest = list(scenario.modules)
    place(largest, dict(scenario.varied))
    for module in largest:
        for dim, size in module.dims().items():
            if isinstance(size, int) and size > LONGEST:
                raise ScenarioError(f"it would have {size} {dim}: at most {LONGEST} is possible")
    layout = _Plan(scenario.modules, dict(scenario.varied), scenario.observed)
    if "agents" not in layout.dims:
        raise ScenarioError("it has no agents")
    if layout.world_bytes > LARGEST:
        raise ScenarioError(f"a world would have {layout.world_bytes} bytes of state: at most {LARGEST} is possible")
    beside = [math.prod(p.shape) * p.component.columns[p.name].dtype.itemsize for p in layout.places if p.offset < 0]
    return layout.dims["agents"], layout.world_bytes + sum(beside)
