"""Checks of the mechanics of a scenario against each other."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

from outlast.ecs import Module
from outlast.ecs.kernels.errors import did_you_mean

from ..errors import ScenarioError
from .derivation import leaders


def check_mechanics(scenario: str, modules: Iterable[Any]) -> None:
    """Raise ScenarioError if one is not an instance of a mechanic. scenario: the name that errors begin with."""
    for module in modules:
        if not isinstance(module, Module):
            raise ScenarioError(f"{scenario}: {module!r} is not a mechanic: pass an instance, as in Melee(damage=20)")


def check_together(scenario: str, modules: Sequence[Module]) -> None:
    """Check that all mechanics can be in one scenario.

    Args:
        scenario: The name that errors begin with.
        modules: Its mechanics.

    Raises:
        ScenarioError: Two take the same slot; two mechanics or numbers have the same name; or a number scales with one
            that no imported mechanic has.
    """
    taken: dict[type, Module] = {}
    owners: dict[str, Module] = {}
    for module in modules:
        other = taken.setdefault(module.slot(), module)
        if other is not module:
            names = " and ".join(sorted(type(each).__name__ for each in (other, module)))
            raise ScenarioError(f"{scenario}: {names} exclude each other; use with_() to replace one by the other")
    for module in modules:
        for name in (module.name, *(f"{module.name}_{item.name}" for item in dataclasses.fields(module))):
            if name in owners:
                one, two = (f"{type(m).__module__}.{type(m).__qualname__}" for m in (owners[name], module))
                raise ScenarioError(
                    f"{scenario}: '{name}' is a name of both {one} and {two}; give one of the mechanics another "
                    'name, a class attribute as in name = "swamp"'
                )
            owners[name] = module
    for name, leader in leaders(modules).items():
        if leader not in owners and leader not in _imported_numbers():
            hint = did_you_mean(leader, owners, before="; ")
            raise ScenarioError(f"{scenario}: {name} scales with '{leader}', which no mechanic has{hint}")


def _imported_numbers() -> set[str]:
    """Return the full names of all numbers of all mechanics that are imported."""
    return {f"{kind.name}_{item.name}" for kind in Module.imported() for item in dataclasses.fields(kind)}
