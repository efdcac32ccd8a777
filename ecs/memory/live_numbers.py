"""Numbers that change while worlds run: which ones can, and why the others cannot.

Kernels read numbers from their argument blocks, so another value costs nothing and compiles nothing. But what is made
only once, with the worlds, stays: tables, what entities begin with, the schedule, scratch memory, bounds of spaces.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ..declarations.numbers import is_read, owners
from ..declarations.system import System
from ..kernels.errors import NumberError, meant
from .layout import MemoryLayout
from .module import Module
from .numbers import fixed_by


def changed_modules(
    layout: MemoryLayout, systems: Sequence[System], present: Sequence[Module], numbers: Mapping[str, Any]
) -> list[Module]:
    """The mechanics with other numbers, in the order of `present`.

    Args:
        layout: The layout of the worlds, with the numbers that they were made with.
        systems: The systems that are scheduled.
        present: The mechanics with their present numbers, in the order of layout.modules.
        numbers: New values by name, "module_number".

    Raises:
        NumberError: A number is unknown or cannot change, or a value is impossible, alone or with the others.
    """
    known, found = owners(present), list(present)
    for name, value in numbers.items():
        if name not in known:
            raise NumberError(f"there is no number '{name}' here; {meant(name, known)}")
        k, own = known[name]
        found[k] = found[k].replace(**{own: value})
        if reason := next(_reasons(layout, systems, k, layout.modules[k].replace(**{own: value}), own), ""):
            raise NumberError(f"{name} cannot change while worlds run: {reason}; make new worlds with the other value")
    layout.with_modules(found).at_extremes()  # raises if they are impossible together
    return found


def differing(modules: Sequence[Module], others: Sequence[Module]) -> dict[str, int | float]:
    """By full name, the numbers of `others` that differ from those of `modules`, as kernels get them."""
    return {
        f"{other.name}_{item.name}": other.value(item.name)
        for module, other in zip(modules, others, strict=True)
        if module is not other
        for item in fields(other)
        if getattr(module, item.name) != getattr(other, item.name)
    }


def _reasons(layout: MemoryLayout, systems: Sequence[System], k: int, other: Module, number: str) -> Iterator[str]:
    """Why worlds of `layout` cannot go on with `other` as their module `k`, from which it differs in one number."""
    module, declared = layout.modules[k], layout.declared[k]
    full = f"{module.name}_{number}"
    if full in layout.per_agent:
        yield "roles differ in it"
    if full in layout.varied:
        yield "it varies from world to world, so give_numbers() sets it"
    if number in {*declared.kinds, *declared.sizes, *(prefab.number for prefab in declared.prefabs)}:
        yield "it is part of what an episode begins with"
    if reason := fixed_by(layout, k, number):
        yield reason
    if [*module.systems()] != [*other.systems()]:
        yield "it decides which systems run"
    if not is_read(layout.modules, systems, full, kinds=("number",)):
        yield "no system gets it as a single number"
    there = layout.with_modules([*layout.modules[:k], other, *layout.modules[k + 1 :]])
    if there.dims != layout.dims:
        yield "it decides how long the rows of observations are"
    if _ends(there) != _ends(layout) or any(
        _plain(one.bounds(layout)) != _plain(two.bounds(there))
        for one, two in zip(layout.modules, there.modules, strict=True)
    ):
        yield "it decides the bounds of observations"


def _ends(layout: MemoryLayout) -> dict[str, dict[str, tuple[Any, Any]]]:
    """The bounds that fields declare, by key and name."""
    return {key: {name: (f.low, f.high) for name, f in named.items()} for key, named in layout.fields.items()}


def _plain(given: Any) -> Any:
    """Bounds as objects that can be compared."""
    if isinstance(given, Mapping):
        return {key: _plain(value) for key, value in given.items()}
    if isinstance(given, (tuple, list)):
        return [_plain(value) for value in given]
    return np.asarray(given).tolist()
