"""The memory layout of a world: archetypes are ranges of rows, components are columns at offsets in its state.

All packed columns of one world are contiguous, so a tick reads one stretch of memory, and to save, copy or reset a
world is to copy bytes. Columns that environments return (actions, observations, signals) have buffers of their own.
"""

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .component import Action, Clock, Column, Component, Entity, Observation, Signal, Singleton, Statistic
from .distributions import Distribution
from .errors import DeclarationError
from .event import Event, memory_type
from .fields import Field, placed, width
from .random import stream_number
from .simd import SIMD_WIDTH
from .varied import DIM, Given, NumbersView, Varied, place

ALIGN = 64  # bytes: a cache line


@dataclass(frozen=True)
class Archetype:
    """`count` entities of one kind and the prefab values of their components.

    Several modules may declare the same archetype: counts add up, components join. A count of 0 extends
    an archetype that another module declares.

    Attributes:
        name: Unique among kinds.
        parts: Its components, with their prefab values.
        count: How many entities this module adds.
        alive: Whether they are in the world right after reset.
        order: Where its rows lie: kinds of smaller numbers come first. Kinds without a number follow all that have one.
            Ties go by name. One number for all modules that declare the kind.
    """

    name: str
    parts: tuple[Component, ...]
    count: int = 0
    alive: bool = True
    order: int | None = None

    def __post_init__(self) -> None:
        parts: Any = self.parts
        if not isinstance(parts, tuple) or not all(isinstance(part, Component) for part in parts):
            raise DeclarationError(
                f"Archetype({self.name!r}, {parts!r:.60}): a tuple of instances of components is needed, as in "
                f"Archetype({self.name!r}, (Health(points=20),)); with one, mind the comma"
            )


@dataclass(frozen=True)
class Place:
    """Where a column lies: its shape in one world, and its offset in the world's state (-1: a buffer of its own)."""

    component: type[Component]
    name: str
    shape: tuple[int, ...]
    offset: int


class Layout:
    """The memory layout of a scenario's worlds, whatever their number.

    Attributes:
        modules: Instances of ecs.module.Module, in order of their names.
        archetypes: Archetype by name, in the order of rows.
        spans: Range of rows by name of the archetype.
        dims: Size by name of the dimension.
        damage_types: The damage types of the modules, in alphabetical order.
        fields: Fields by key of the observation and by name, in order of their columns; of keys that declare some.
        places: Every column.
        events: The events, in the order of `event_type`, the memory that they take in a world.
        initial_image: uint8 (world_bytes,), the state of a world at the start of an episode, before any system runs and
            before numbers are drawn.
        varied: Numbers of which each world has its own, by name.

    Args:
        modules: The mechanics, in any order.
        distributions: What numbers are drawn from for each episode of each world, by name, "module_number".
        observed: Those of them that are shown to agents, in varied.NumbersView.
    """

    def __init__(
        self,
        modules: Sequence[Any],
        distributions: Mapping[str, Distribution] | None = None,
        observed: Sequence[str] = (),
    ) -> None:
        self.modules = sorted(modules, key=lambda module: (module.name, type(module).__name__))
        self.varied = place(self.modules, distributions or {})
        self.archetypes = _merge(a for module in self.modules for a in listed(module, "archetypes", Archetype))
        self._check_counts()
        self.spans: dict[str, range] = {}
        start = 0
        for name, archetype in self.archetypes.items():
            self.spans[name] = range(start, start + archetype.count)
            start += archetype.count
        self.dims = {"rows": start, "blocks": -(-start // SIMD_WIDTH)}
        self.damage_types = sorted({module.damage_type for module in self.modules if module.damage_type})
        self.dims["damage_types"] = len(self.damage_types)
        named = [item for module in self.modules for item in module.dims().items()]
        for dim, size in sorted(named, key=lambda item: isinstance(item[1], str)):
            names = size.split("+") if isinstance(size, str) else []
            more = sum(self.dims.get(name.strip(), 0) for name in names) if names else size
            self.dims[dim] = self.dims.get(dim, 0) + more
        self.singletons = {type(s): s for module in self.modules for s in listed(module, "singletons", Singleton)}
        self.fields: dict[str, dict[str, Field]] = placed(self, self._observations(), Observation.keys())
        if observed:
            self._observe(observed)
        self.dims |= {f"{key} fields": width(fields) for key, fields in self.fields.items()}
        for module in self.modules:
            module.check(self)
        attached = {type(part) for a in self.archetypes.values() for part in a.parts}
        others = sorted(attached | self.singletons.keys(), key=lambda c: (c.__module__, c.__qualname__))
        if self.varied:
            self.dims[DIM] = sum(number.width for number in self.varied.values())
        own = (Clock, Given, Varied, Entity) if self.varied else (Clock, Entity)
        self.components: tuple[type[Component], ...] = (*own, *others)
        self._check_dims()
        for base in (Action, Observation, Signal, Statistic):
            _check_keys(base, self.components)
        self.events = self._events()
        self.event_type = memory_type(self.events, self.dims)
        self.places, self.world_bytes = self._place()
        self.initial_image = self._initial_image()

    def __repr__(self) -> str:
        """A line for each archetype: its rows, whether they are alive after reset, and its components."""
        lines = [
            f"Layout({self.dims['rows']} rows, {len(self.components)} components, {self.world_bytes} bytes a world)"
        ]
        for name, archetype in self.archetypes.items():
            span, parts = self.spans[name], ", ".join(type(part).__name__ for part in archetype.parts)
            here = f"row {span.start}" if len(span) == 1 else f"rows {span.start} to {span.stop - 1}"
            lines.append(f"  {name}: {here}{'' if archetype.alive else ', not alive at first'}: {parts}")
        return "\n".join(lines)

    def rows(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """int32 rows of all entities whose archetype has every one of `components`."""
        rows = [
            row
            for name, archetype in self.archetypes.items()
            if {Entity, *(type(part) for part in archetype.parts)}.issuperset(components)
            for row in self.spans[name]
        ]
        return np.array(rows, np.int32)

    def bitset(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """int32 (blocks,): bit j of block b is set if row 16 b + j is one of `rows(*components)`."""
        bits = np.zeros(self.dims["blocks"], np.int32)
        rows = self.rows(*components)
        np.bitwise_or.at(bits, rows // SIMD_WIDTH, 1 << rows % SIMD_WIDTH)
        return bits

    def row_index(self, *components: type[Component]) -> np.ndarray[Any, Any]:
        """int32 (rows,): each row's index in `rows(*components)`, -1 for the others."""
        index = np.full(self.dims["rows"], -1, np.int32)
        rows = self.rows(*components)
        index[rows] = np.arange(len(rows))
        return index

    def numbers(self, module: str) -> dict[str, Any]:
        """The numbers of the module of that name, or of a subclass of it, by their own names; none without one."""
        found = [each for each in self.modules if module in (getattr(base, "name", "") for base in type(each).__mro__)]
        return {item.name: getattr(each, item.name) for each in found for item in fields(each)}

    def prefab_values(self, component: type[Component], column: str) -> dict[str, Any]:
        """Prefab value of a column (one, or one an entity) by name of the archetypes that have the component."""
        fill = component.columns[column].fill
        parts = ((name, part) for name, archetype in self.archetypes.items() for part in archetype.parts)
        return {name: part.fills.get(column, fill) for name, part in parts if type(part) is component}

    def check_count(self, component: type[Component], dim: str) -> None:
        """DeclarationError unless the dimension `dim` is the number of entities that have the component."""
        count, size = len(self.rows(component)), self.dims.get(dim, 0)
        if count != size:
            raise DeclarationError(
                f"{count} entities have {component.__name__}, but the dimension '{dim}' is {size}: a module that "
                f"brings more of them adds to it, as in def dims(self): return {{'{dim}': self.count}}"
            )

    def _observe(self, names: Sequence[str]) -> None:
        """Show varied numbers to agents."""
        self.singletons[NumbersView], start, shown = NumbersView(), 0, dict[str, Field]()
        for name in names:
            shown[name] = self.varied[name].field(start)
            start += self.varied[name].width
        self.fields["numbers"] = shown

    def _events(self) -> tuple[type[Event], ...]:
        """The events, with their capacities among the dimensions; of a dimension that nobody defines, 0."""
        found: dict[str, type[Event]] = {}
        for event in self.components:
            if not issubclass(event, Event):
                continue
            if (other := found.setdefault(event.name, event)) is not event:
                one, two = (f"{each.__module__}.{each.__qualname__}" for each in (other, event))
                raise DeclarationError(f"{one} and {two} are both the event '{event.name}'; rename one of the classes")
            capacity = event.capacity
            if isinstance(capacity, type):
                capacity = len(self.rows(capacity))
            self.dims[event.capacity_dim()] = self.dims.get(capacity, 0) if isinstance(capacity, str) else capacity
        return tuple(found.values())

    @property
    def actions(self) -> list[tuple[type[Component], str]]:
        """Columns of actions as (component, name), in the `order` of their components."""
        kinds = [component for component in self.components if issubclass(component, Action)]
        kinds.sort(key=lambda component: (component.order, component.__qualname__))
        return [(component, name) for component in kinds for name in component.columns]

    def _observations(self) -> dict[str, tuple[str, Column]]:
        """The mechanic that brings it and the column of every observation, by key."""
        brought = [
            (module.name, singleton) for module in self.modules for singleton in listed(module, "singletons", Singleton)
        ]
        return {
            column.key or name: (module, column)
            for module, singleton in brought
            for name, column in (singleton.columns.items() if isinstance(singleton, Observation) else ())
        }

    def _check_counts(self) -> None:
        """DeclarationError if an archetype is only extended."""
        for name, archetype in self.archetypes.items():
            if archetype.count == 0:
                makers = self.modules[0].providers(
                    lambda module: any(kind.name == name and kind.count for kind in module.archetypes())  # noqa: B023
                )
                near = difflib.get_close_matches(name, [name for name, kind in self.archetypes.items() if kind.count])
                cure = f"did you mean {' or '.join(map(repr, near))}?" if near else "add a module that does"
                raise DeclarationError(
                    f"modules extend the archetype '{name}', but none declares how many there are; "
                    f"{f'add {makers}' if makers else cure}"
                )

    def _check_dims(self) -> None:
        """DeclarationError if a column has a dimension that no module defines."""
        for component in self.components:
            for name, column in component.columns.items():
                for dim in column.dims:
                    if isinstance(dim, str) and dim not in self.dims:
                        makers = self.modules[0].providers(lambda module: dim in module.dims())  # noqa: B023
                        raise DeclarationError(
                            f"no module defines the dimension '{dim}'; known: {', '.join(sorted(self.dims))}. "
                            f"{component.__name__}.{name} needs it: add {makers or 'a module whose dims() has it'}"
                        )

    def _place(self) -> tuple[list[Place], int]:
        places, offset = [], 0
        for component in self.components:
            for name, column in component.columns.items():
                shape = component.row_shape(name, self.dims)
                if not component.packed:
                    places.append(Place(component, name, shape, -1))
                    continue
                offset = -(-offset // column.dtype.itemsize) * column.dtype.itemsize
                places.append(Place(component, name, shape, offset))
                offset += column.dtype.itemsize * int(np.prod(shape))
        return places, max(ALIGN, -(-offset // ALIGN) * ALIGN)

    def columns(self, block: np.ndarray[Any, Any], component: type[Component]) -> Any:
        """Table of a packed component over `block`, uint8 (worlds, world_bytes): columns (worlds, ...)."""
        return component.Table(
            *(
                np.ndarray(
                    (len(block), *place.shape),
                    component.columns[place.name].dtype,
                    block,
                    place.offset,
                    (block.strides[0], *_strides(place.shape, component.columns[place.name].dtype.itemsize)),
                )
                for place in self.places
                if place.component is component
            )
        )

    def _initial_image(self) -> np.ndarray[Any, Any]:
        block = np.zeros((1, self.world_bytes), np.uint8)
        for singleton, values in self.singletons.items():
            if singleton.packed:
                _fill(self.columns(block, singleton), slice(None), values)
        for name, archetype in self.archetypes.items():
            span = slice(self.spans[name].start, self.spans[name].stop)
            entity = self.columns(block, Entity)
            entity.alive[0, span] = archetype.alive
            kind = stream_number(name) >> 33 << 32  # positive, with room for 2**32 entities of a kind
            entity.identity[0, span] = kind + np.arange(archetype.count)
            for part in archetype.parts:
                _fill(self.columns(block, type(part)), (0, span), part)
        return np.ascontiguousarray(block[0])


def _check_keys(base: type[Component], components: Iterable[type[Component]]) -> None:
    """DeclarationError if two columns of a kind have one key, as environments would publish only one of them."""
    owners: dict[str, str] = {}
    for component in components:
        for name, column in component.columns.items() if issubclass(component, base) else ():
            key, owner = column.key or name, f"{component.__module__}.{component.__qualname__}.{name}"
            if key in owners:
                raise DeclarationError(
                    f"{owners[key]} and {owner} are both the {base.__name__.lower()} '{key}'; rename one of the "
                    'columns, or give it another key: column(..., key="mine")'
                )
            owners[key] = owner


def _strides(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    return tuple(itemsize * int(np.prod(shape[k + 1 :])) for k in range(len(shape)))


def _fill(table: Any, where: Any, part: Component) -> None:
    for name, column in part.columns.items():
        getattr(table, name)[where] = part.fills.get(name, column.fill)


def _merge(parts: Iterable[Archetype]) -> dict[str, Archetype]:
    """Join the declarations of each archetype by several modules, in the order of rows."""
    merged: dict[str, Archetype] = {}
    for part in parts:
        before = merged.get(part.name, Archetype(part.name, ()))
        have = {type(component) for component in before.parts}
        for component in part.parts:
            if isinstance(component, Singleton):
                raise DeclarationError(f"{type(component).__name__} is per world and cannot be part of '{part.name}'")
            if type(component) in have:
                raise DeclarationError(f"two modules give '{part.name}' the component {type(component).__name__}")
        orders = {before.order, part.order} - {None}
        if len(orders) > 1:
            raise DeclarationError(
                f"modules give '{part.name}' the orders {before.order} and {part.order}; let one of them leave it out"
            )
        merged[part.name] = Archetype(
            part.name,
            before.parts + part.parts,
            before.count + part.count,
            before.alive and part.alive,
            next(iter(orders), None),
        )
    places = {name: math.inf if kind.order is None else kind.order for name, kind in merged.items()}
    return {name: merged[name] for name in sorted(merged, key=lambda name: (places[name], name))}


def listed(module: Any, method: str, kind: type[Any]) -> list[Any]:
    """What a module's method returns, as a list. DeclarationError if it is no list of instances of `kind`."""
    given = getattr(module, method)()
    many = isinstance(given, Iterable)
    items = list(given) if many else [given]
    for item in items:
        if not (many and isinstance(item, kind)):
            found = item if isinstance(item, type) else type(item)
            shown = f"the class {found.__name__}" if found is item else found.__name__
            example = found if issubclass(found, kind) else kind
            raise DeclarationError(
                f"{module.name}.{method}() returned {'a list with ' if many else ''}{shown}: a list of instances of "
                f"{kind.__name__} is needed, as in return [{example.__name__}(...)]"
            )
    return items
