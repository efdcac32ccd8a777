"""Numbers that can vary, differ by role or change while worlds run, and reasons why others cannot.

A number can vary or differ by role if systems get it, and if declarations name it by `ref`. It can change while worlds
run if only systems get it: kernels read numbers from their argument blocks, so another value has no cost and needs no
compiling. But everything that is created once with the worlds is fixed: tables, first values of entities, the schedule,
scratch memory, bounds of spaces.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ..declarations.declared import PrefabNumber, entries
from ..declarations.module import Module
from ..declarations.numbers import is_read, owners, rule_of
from ..declarations.system import System
from ..kernels.errors import NumberError, meant
from .layout import MemoryLayout
from .numbers import Number, encode

Patch = tuple[int, int, int]  # a word, and the place in the state and the size in bytes of its prefab value


def check_numbers(layout: MemoryLayout) -> None:
    """Raise NumberError if a number cannot vary or differ by role as requested."""
    for by_role in (False, True):
        patches(layout, by_role)
    if layout.varied or layout.per_agent:
        layout.at_extremes(fewer=True)


@functools.lru_cache(maxsize=32)
def patches(layout: MemoryLayout, by_role: bool) -> list[Patch]:
    """Return the prefab values that are numbers of agents, or of worlds. Raises NumberError if one cannot differ."""
    numbers = layout.per_agent if by_role else layout.varied
    return [patch for number in numbers.values() for patch in _patches(layout, number)]


def _patches(layout: MemoryLayout, number: Number) -> list[Patch]:
    """Return the prefab values that equal a number.

    Raises:
        NumberError: The number cannot differ: a declaration uses its value, not `ref`; or its prefab value has a column
            that cannot hold it; or nothing depends on it.
    """
    what = f"{number.name} cannot {'differ by role' if number.by_role else 'vary'}"
    if reason := _fixed(layout, number) or fixed_by(layout, number.module, number.field):
        raise NumberError(f"{what}: {reason}")
    places = {(each.component, each.name): each for each in layout.places}
    found = list[Patch]()
    for prefab in layout.declared[number.module].prefabs:
        if prefab.number == number.field:
            if reason := _misfit(layout, number, prefab):
                raise NumberError(f"{what}: {reason}")
            where = places[prefab.component, prefab.column]
            size = where.dtype.itemsize
            for row, k in entries(prefab, where.shape, layout.spans):
                found.append((number.start + row * number.by_role, where.offset + k * size, size))
    if not (found or number.kinds or is_read(layout.modules, layout.systems, number.name)):
        raise NumberError(f"{what}: no system of {layout.modules[number.module].name} gets it")
    return found


def _fixed(layout: MemoryLayout, number: Number) -> str:
    """Return the reason why a number that counts entities or sizes rows cannot differ; "" if it can."""
    declared = layout.declared[number.module]
    if number.by_role and (counted := declared.kinds.get(number.field)):
        return f"it counts the entities {counted[0]!r}"
    if (sized := declared.sizes.get(number.field)) and not number.kinds:
        return f"it decides how large the dimension {sized[0]!r} is, and counts no entities"
    if number.field in declared.observes:
        module = layout.modules[number.module]
        if len({_field_sizes(module.replace(**{number.field: value})) for value in number.values}) > 1:
            return f"{type(module).__name__}.fields() reads it: it decides how long the rows of observations are"
    highest = number.distribution.extremes()[-1]
    if shared := [name for name in number.kinds if layout.archetypes[name].count > highest]:
        return f"it is not the only count of the entities {shared[0]!r}"
    return ""


def _field_sizes(module: Module) -> tuple[tuple[str, str, int | str], ...]:
    return tuple((key, field.name, field.size) for key, added in module.fields().items() for field in added)


def fixed_by(layout: MemoryLayout, k: int, field: str) -> str:
    """Return the reason why a number of the mechanic `k` is fixed when worlds are made; "" if it is not."""
    declared, module = layout.declared[k], layout.modules[k]
    kind = type(module).__name__
    if method := declared.reads.get(field):
        cure = f"; a prefab value or a count that is the number itself can be ref({field!r})" * (method != "dims")
        return f"{kind}.{method}() reads it when worlds are made{cure}"
    if field in declared.selects and not rule_of(module, field).get("per_agent"):
        return f"{kind}.systems() reads it: it decides which systems run"
    if field in declared.scratch(layout.dims):
        return f"{kind}.scratch() reads it: it decides how much memory systems have"
    return ""


def _misfit(layout: MemoryLayout, number: Number, prefab: PrefabNumber) -> str:
    """Return the reason why a prefab value cannot be a number that differs; "" if it can."""
    what, held = f"{prefab.component.__name__}.{prefab.column}", prefab.component.columns[prefab.column]
    if number.by_role and not (prefab.kind and layout.archetypes[prefab.kind].roles):
        return f"{what}{f' of {prefab.kind!r}' * bool(prefab.kind)} is the number, and only agents have roles"
    if number.kind is tuple:
        return f"{what} is the number, and a tuple can only be given to systems"
    if not (held.dtype == number.dtype or (held.dtype.itemsize == 1 and number.kind is not float)):
        own = number.dtype.str[1:]
        return f"{what} is {held.dtype}, and the number {number.kind.__name__}: the column needs the type {own!r}"
    limits = np.iinfo(held.dtype) if held.dtype.kind in "iu" else None
    ends = held.range(layout.dims) or (limits and (limits.min, limits.max))
    for value in (value for drawn in number.distributions for value in drawn.extremes()):
        plain = encode(layout.modules[number.module], number.field, value)[0]
        if ends and not ends[0] <= plain <= ends[1]:
            return f"{what} has the range {ends[0]} to {ends[1]}, and the number can be {value}"
    return ""


def changed_modules(
    layout: MemoryLayout, systems: Sequence[System], present: Sequence[Module], numbers: Mapping[str, Any]
) -> list[Module]:
    """Return the mechanics with other numbers, in the order of `present`.

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
            raise NumberError(f"unknown number '{name}'; {meant(name, known)}")
        k, own = known[name]
        found[k] = found[k].replace(**{own: value})
        if reason := next(_reasons(layout, systems, k, layout.modules[k].replace(**{own: value}), own), ""):
            raise NumberError(f"{name} cannot change while worlds run: {reason}; make new worlds with the other value")
    layout.with_modules(found).at_extremes()  # raises if they do not fit each other
    return found


def differing(modules: Sequence[Module], others: Sequence[Module]) -> dict[str, int | float]:
    """Return, by full name, the numbers of `others` that differ from those of `modules`, in the form for kernels."""
    return {
        f"{other.name}_{item.name}": other.value(item.name)
        for module, other in zip(modules, others, strict=True)
        if module is not other
        for item in fields(other)
        if getattr(module, item.name) != getattr(other, item.name)
    }


def _reasons(layout: MemoryLayout, systems: Sequence[System], k: int, other: Module, number: str) -> Iterator[str]:
    """Yield the reasons why worlds of `layout` cannot continue with `other`, unlike module `k` in one number."""
    module, declared = layout.modules[k], layout.declared[k]
    full = f"{module.name}_{number}"
    if full in layout.per_agent:
        yield "roles differ in it"
    if full in layout.varied:
        yield "it varies from world to world, so give_numbers() sets it"
    if number in {*declared.kinds, *declared.sizes, *(prefab.number for prefab in declared.prefabs)}:
        yield "it is part of the initial state of episodes"
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
    """Return the bounds that fields declare, by key and name."""
    return {key: {name: (f.low, f.high) for name, f in named.items()} for key, named in layout.fields.items()}


def _plain(given: Any) -> Any:
    """Return bounds as comparable objects."""
    if isinstance(given, Mapping):
        return {key: _plain(value) for key, value in given.items()}
    if isinstance(given, (tuple, list)):
        return [_plain(value) for value in given]
    return np.asarray(given).tolist()
