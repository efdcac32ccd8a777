"""Declared entities, singletons and sizes, and the numbers of the mechanic that they depend on.

A declaration names a number by `ref`, as in Health(points=ref("points")); then the number can vary, since the engine
knows where to write it when an episode begins. A number that a declaration reads as an attribute is fixed when worlds
are made: the methods are called on a copy of the mechanic that records the numbers read.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..kernels.errors import DeclarationError, did_you_mean
from .archetype import Archetype
from .component import Component, Ref, Singleton
from .module import RECORDS, Module

Part = TypeVar("Part", bound=Component)
Kind = TypeVar("Kind", Archetype, Singleton)


@dataclass(frozen=True)
class PrefabNumber:
    """A prefab value that is a number.

    Attributes:
        number: The number's name in its mechanic.
        kind: The kind of entities; "" for a singleton.
        component: The component.
        column: Its column.
    """

    number: str
    kind: str
    component: type[Component]
    column: str


@dataclass(frozen=True)
class Declared:
    """The declarations of a mechanic, with values in place of references.

    Attributes:
        module: The mechanic.
        archetypes: The kinds of entities that it adds or extends.
        singletons: The per-world components that it adds.
        dims: Sizes by dimension.
        prefabs: The prefab values that are numbers.
        kinds: By number, the kinds of entities that it counts.
        sizes: By number, the dimensions of that size.
        reads: By number that is read as an attribute, the method that reads it.
    """

    module: Module
    archetypes: list[Archetype] = field(default_factory=list)
    singletons: list[Singleton] = field(default_factory=list)
    dims: Mapping[str, int | str] = field(default_factory=dict)
    prefabs: list[PrefabNumber] = field(default_factory=list)
    kinds: dict[str, tuple[str, ...]] = field(default_factory=dict)
    sizes: dict[str, tuple[str, ...]] = field(default_factory=dict)
    reads: dict[str, str] = field(default_factory=dict)

    @cached_property
    def selects(self) -> set[str]:
        """The numbers that select the systems that run."""
        copy, reads = recording(self.module)
        list(copy.systems())
        return reads

    @cached_property
    def observes(self) -> set[str]:
        """The numbers on which fields of observations depend."""
        copy, reads = recording(self.module)
        copy.fields()
        return reads

    def scratch(self, dims: dict[str, int]) -> set[str]:
        """Return the numbers on which the memory of systems depends. dims: sizes by name of the dimension."""
        copy, reads = recording(self.module)
        for name in {p.name for system in self.module.systems() for p in system.parameters if p.kind == "scratch"}:
            copy.scratch(name, dims)
        return reads

    def _resolved(self, part: Part, kind: str) -> Part:
        """Return a component with the values of the numbers that it names."""
        found = {name: _plain(value) for name, value in part.fills.items()}
        for column, value in found.items():
            if isinstance(value, Ref):
                self.prefabs.append(PrefabNumber(value.name, kind, type(part), column))
                found[column] = self._value(value, f"{kind}{': ' * bool(kind)}{type(part).__name__}.{column}")
        made = object.__new__(type(part))
        made.fills = found
        return made

    def _value(self, given: Ref, where: str) -> Any:
        known = [item.name for item in dataclasses.fields(self.module)]
        if given.name not in known:
            hint = did_you_mean(given.name, known) or f"it has: {', '.join(known) or 'none'}"
            raise DeclarationError(
                f"{where} is ref({given.name!r:.60}), which is not a number of {self.module.name}; {hint}"
            )
        return self.module.value(given.name)


def declare(module: Module) -> Declared:
    """Return the declarations of a mechanic. DeclarationError if a method returns another type."""
    made = Declared(module)
    for archetype in _listed(made, "archetypes", Archetype):
        count: Any = archetype.count
        if isinstance(count, Ref):
            made.kinds[count.name] = (*made.kinds.get(count.name, ()), archetype.name)
            count = made._value(count, f"the count of {archetype.name!r}")
        parts = tuple(made._resolved(part, archetype.name) for part in archetype.parts)
        made.archetypes.append(dataclasses.replace(archetype, count=count, parts=parts))
    made.singletons.extend(made._resolved(part, "") for part in _listed(made, "singletons", Singleton))
    declared = _noted(made, "dims")
    if not isinstance(declared, Mapping):
        raise DeclarationError(f"{module.name}.dims() returned {type(declared).__name__}: a dict is needed")
    dims = dict(declared)
    for dim, size in dims.items():
        if isinstance(size, Ref):
            made.sizes[size.name] = (*made.sizes.get(size.name, ()), dim)
            dims[dim] = made._value(size, f"the dimension '{dim}'")
    return dataclasses.replace(made, dims=dims)


def _noted(made: Declared, method: str) -> Any:
    """Return the result of a method of the mechanic, and record the numbers that it reads."""
    copy, reads = recording(made.module)
    found = getattr(copy, method)()
    found = list(found) if isinstance(found, Iterator) else found  # a generator reads them now
    made.reads.update((name, method) for name in reads if name not in made.reads)
    return found


def _listed(made: Declared, method: str, kind: type[Kind]) -> list[Kind]:
    """Return the result of a method as a list. DeclarationError unless it is one of instances of `kind`."""
    given = _noted(made, method)
    many = isinstance(given, Iterable)
    items = list(given) if many else [given]
    for item in items:
        if not (many and isinstance(item, kind)):
            found = item if isinstance(item, type) else type(item)
            shown = f"the class {found.__name__}" if found is item else found.__name__
            example = found if issubclass(found, kind) else kind
            raise DeclarationError(
                f"{made.module.name}.{method}() returned {'a list with ' if many else ''}{shown}: a list of instances "
                f"of {kind.__name__} is needed, as in return [{example.__name__}(...)]"
            )
    return items


class Elements(Sequence[float]):
    """A number that is a tuple, in a recording copy. Reading its length is free: it is the same in all worlds."""

    def __init__(self, values: tuple[float, ...], name: str, reads: set[str]) -> None:
        self._values, self._name, self._reads = values, name, reads

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, index: Any) -> Any:
        self._reads.add(self._name)
        return self._values[index]

    def __eq__(self, other: object) -> bool:
        return bool(tuple(self) == other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))


def _plain(value: Any) -> Any:
    """Return a prefab value without `Elements`, whose elements are thereby read."""
    if isinstance(value, (Elements, list, tuple)):
        return type(value)(map(_plain, value)) if isinstance(value, list) else tuple(map(_plain, value))
    return value


def recording(module: Module) -> tuple[Module, set[str]]:
    """Return a copy of a mechanic, and the growing set of its numbers that have been read from the copy."""
    reads = set[str]()
    copy = object.__new__(_recording_class(type(module)))
    vars(copy).update(vars(module) | {RECORDS: reads})
    return copy, reads


def _recording_class(kind: type[Any]) -> type[Any]:
    """Return a subclass whose instances record the numbers read. It is stored in the class, and deleted with it."""
    if "_recording" not in vars(kind):
        numbers = frozenset(item.name for item in dataclasses.fields(kind))

        def get(self: Any, name: str) -> Any:
            value = object.__getattribute__(self, name)
            reads = object.__getattribute__(self, "__dict__").get(RECORDS) if name in numbers else None
            if reads is None:
                return value
            if isinstance(value, tuple):
                return Elements(value, name, reads)
            reads.add(name)
            return value

        own = {"__module__": kind.__module__, "__qualname__": kind.__qualname__, "__getattribute__": get}
        meta: Any = type(kind)
        kind._recording = meta(kind.__name__, (kind,), {**own, RECORDS: None})
    found: type[Any] = vars(kind)["_recording"]
    return found


def one_of_each(declared: Sequence[Declared]) -> dict[type[Component], Singleton]:
    """Return the singletons of the modules, by type.

    DeclarationError if two modules give the same one different values.
    """
    found: dict[type[Component], tuple[str, Singleton]] = {}
    for each in declared:
        for own in each.singletons:
            name, other = found.setdefault(type(own), (each.module.name, own))
            for column, kind in own.columns.items():
                one, two = (part.fills.get(column, kind.fill) for part in (other, own))
                if not np.array_equal(one, two):
                    raise DeclarationError(
                        f"{name} gives {type(own).__name__}.{column} the value {one!r:.60}, {each.module.name} "
                        f"{two!r:.60}: let one of them bring it, or both the same"
                    )
    return {kind: singleton for kind, (_, singleton) in found.items()}


def entries(prefab: PrefabNumber, shape: Sequence[int], spans: Mapping[str, range]) -> Iterator[tuple[int, int]]:
    """Yield the rows (0 for a singleton) and the entries of the column that hold a number.

    Args:
        prefab: The prefab value.
        shape: The column's shape in one world.
        spans: Ranges of rows by kind of entities.
    """
    rows, each = (spans[prefab.kind], math.prod(shape[1:])) if prefab.kind else (range(1), math.prod(shape))
    for row in rows:
        yield from ((row, row * each + k) for k in range(each))
