"""Scenarios in files: naming the classes of their mechanics, making scenarios from these names, limiting their size."""

from typing import Any

from outlast.ecs import MemoryLayout
from outlast.ecs.checks.code_hash import full_name

from ..errors import ScenarioError
from .mechanics import rebuilt_mechanics
from .scenario import Scenario
from .varying_json import restored

LARGEST = 2**22  # bytes of the state of one world at most


def classes(scenario: Scenario) -> list[str]:
    """Return the full names of the classes of its modules, in order."""
    return sorted(full_name(type(module)) for module in scenario.modules)


def rebuilt(fingerprint: dict[str, Any], names: list[str], strict: bool = True) -> Scenario:
    """Make the scenario of a fingerprint and the full names of its classes. Raises errors like `rebuilt_mechanics`."""
    modules = rebuilt_mechanics(sorted(names), fingerprint["numbers"], strict)
    name = str(fingerprint.get("label") or fingerprint["name"])
    order = tuple(map(tuple, fingerprint.get("order", ())))
    return Scenario(name, modules, order=order, **restored(modules, fingerprint))


def planned(scenario: Scenario) -> tuple[int, int]:
    """Return how many agents a world has, and how many bytes it takes, while allocating next to nothing.

    Raises ScenarioError if a world is absurdly large or has no agents, and the errors of MemoryLayout.
    """
    layout = MemoryLayout(scenario.modules, dict(scenario.varied), scenario.observed, scenario.by_role)
    if "agents" not in layout.dims:
        raise ScenarioError("it has no agents")
    if layout.world_bytes > LARGEST:
        raise ScenarioError(f"a world would have {layout.world_bytes} bytes of state: at most {LARGEST} is possible")
    beside = sum(place.nbytes for place in layout.places if place.offset < 0)
    return layout.dims["agents"], layout.world_bytes + beside
