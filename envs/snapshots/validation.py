"""Validation of saved states: everything used as an index is in range, and booleans are 0 or 1.

Compiled kernels do not check indices: one out of range would read or write other memory. So outlast's own components
declare the range of columns that kernels or views use as an index, a length or a part of an address. Other columns do
no harm, for any content: they are only compared, counted or used in calculations.

Mechanics of your own should also declare the range of columns that hold an index. If they do not, these are not
checked, and you should only load states from people you trust:

    owner: Array = column("i4", fill=-1, unit="entity")   # a row, -1: none
    phase: Array = column("i4", low=0, high=7)

A valid state need not be one that can occur in a game: an item may be in two bags, or an agent in a wall.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Side, Sight
from outlast.ecs import Component, Entity, MemoryLayout, Place, Singleton
from outlast.ecs.declarations.event import COUNT, EventMemory, table
from outlast.ecs.memory.given import misfits, wrongly_given
from outlast.ecs.memory.numbers import Given, Varied

from ..errors import StateError

Array = np.ndarray[Any, Any]


def check(layout: MemoryLayout, arrays: dict[str, Array]) -> None:
    """Raise StateError unless the arrays of a state, including "world", are valid in worlds of that layout.

    Worlds that have not started are reset before anything runs in them, so they may hold initial values.
    """
    for name, array in arrays.items():
        if array.dtype == bool and (array.view(np.uint8) > 1).any():
            raise StateError(f"the state's array '{name}' holds bytes that are neither 0 nor 1")
    block = np.ascontiguousarray(arrays["world"])
    for span in _spans(layout):
        values = span.values(block)
        if not (values < span.low).any() and not (values > span.last).any():
            continue
        bad = (values < span.low) | (values > span.last)
        if "started" in arrays:
            fresh = ~arrays["started"]
            bad[fresh] &= (values != span.values(layout.initial_image[None]))[fresh]
        if bad.any():
            raise _refusal(span.name, span.rows, values, bad, f"{span.low} to {span.last} is needed")
    _check_bags(layout, block)
    _check_sight(layout, block)
    started = arrays.get("started", np.ones(len(block), bool))
    _check_varied(layout, block, started)
    _check_absent(layout, block, started)


def event_memory(layout: MemoryLayout, counts: Array, lists: Array) -> EventMemory:
    """Return the events in a state's arrays, int32 (worlds, kinds) and uint8 (worlds, bytes), as a view of these."""
    return EventMemory(counts, lists.view(layout.event_type).reshape(-1))


def check_events(layout: MemoryLayout, counts: Array, given: Array) -> None:
    """Raise StateError unless the events of a state are valid lists.

    counts: int32 (worlds, kinds). given: the lists, uint8 (worlds, bytes).
    """
    memory = event_memory(layout, counts, np.ascontiguousarray(given))
    for event in layout.events:
        found, capacity = table(event, layout.events, memory), layout.dims[event.capacity_dim()]
        if ((found.count < 0) | (found.count > capacity)).any():
            raise StateError(f"the state's {event.__name__}.count is not between 0 and {capacity}")
        for name, column in event.columns.items():
            if name != COUNT and (ends := column.range(layout.dims)) and found.count.any():
                values, (low, high) = getattr(found, name), ends
                used = np.arange(capacity).reshape(-1, *[1] * (values.ndim - 2)) < found.count.reshape(
                    -1, *[1] * (values.ndim - 1)
                )
                if (used & ((values < low) | (values > high))).any():
                    raise StateError(f"the state's {event.__name__}.{name} is not between {low} and {high}")


@dataclass(frozen=True)
class Span:
    """A column to check: its place in a world, the rows that count, and the smallest and largest number allowed."""

    name: str
    place: Place
    dtype: np.dtype[Any]
    rows: slice | Array
    low: int
    last: int

    def values(self, block: Array) -> Array:
        """Return the values of the column in blocks of worlds, uint8 (worlds, bytes): (worlds, rows, ...)."""
        inner = np.empty(self.place.shape, self.dtype).strides
        shape = (len(block), *self.place.shape)
        column: Array = np.ndarray(shape, self.dtype, block, self.place.offset, (block.strides[0], *inner))
        return column[:, self.rows]


@functools.lru_cache(maxsize=16)
def _spans(layout: MemoryLayout) -> tuple[Span, ...]:
    """Return the columns to check in worlds of that layout; cached, as a search restores single worlds very often."""
    found = []
    for place in layout.places:
        if place.offset >= 0 and (ends := place.component.columns[place.name].range(layout.dims)):
            name, dtype = (
                f"{place.component.__name__}.{place.name}",
                np.dtype("u1") if place.dtype == bool else place.dtype,
            )
            found.append(Span(name, place, dtype, _rows(layout, place.component), *ends))
    return tuple(found)


def _rows(layout: MemoryLayout, component: type[Component]) -> slice | Array:
    """Return the rows of entities that have the component: if they are adjacent a slice, which avoids a copy."""
    if issubclass(component, Singleton):
        return slice(None)
    rows = layout.rows(component)
    together = len(rows) > 0 and rows[-1] - rows[0] == len(rows) - 1
    return slice(int(rows[0]), int(rows[-1]) + 1) if together else rows


def _check_bags(layout: MemoryLayout, block: Array) -> None:
    """Check that every slot of a bag below its count holds an item."""
    if Bag in layout.components:
        bag, rows = layout.columns(block, Bag), _rows(layout, Bag)
        items, count = bag.items[:, rows], bag.count[:, rows]
        bad = (items < 0) & (np.arange(items.shape[2]) < count[..., None])
        if bad.any():
            raise _refusal("Bag.items", rows, items, bad, "a row is needed, as the slot is in use by Bag.count")


def _check_sight(layout: MemoryLayout, block: Array) -> None:
    """Check that the sets of visible entities contain existing rows only."""
    if Sight in layout.components:
        visible = layout.columns(block, Sight).visible
        if (bad := visible & ~layout.bitset(Entity) != 0).any():
            raise _refusal("Sight.visible", slice(None), visible, bad, "a set of existing rows is needed")


def _check_absent(layout: MemoryLayout, block: Array, started: Array) -> None:
    """Check that exactly the entities beyond a varied count are absent."""
    identity = layout.columns(block, Entity).identity
    absent = np.zeros_like(identity, dtype=bool)
    for number in layout.varied.values():
        words = layout.columns(block, Varied).words[:, number.start, None]
        for name in number.kinds:
            rows = np.array(layout.spans[name])
            absent[:, rows] = rows - rows[0] >= words
    if (bad := started[:, None] & ((identity < 0) != absent)).any():
        raise _refusal(
            "Entity.identity", slice(None), identity, bad, "-1 is needed for absent entities, and only for these"
        )
    if Side in layout.components:
        rows = layout.rows(Side)
        side = layout.columns(block, Side).side[:, rows]
        bad = started[:, None] & ((side < 0) != absent[:, rows])
        if bad.any():
            raise _refusal("Side.side", rows, side, bad, f"0 to {layout.dims['sides'] - 1} is needed")


def _check_varied(layout: MemoryLayout, block: Array, started: Array) -> None:
    """Check that varied and given numbers could have been drawn, as counts among them are used as indices."""
    if not layout.keyed:
        return
    words = layout.columns(block, Varied).words
    for name, number in layout.varied.items():
        wrong = started & misfits(number, layout, words[:, number.words])
        if wrong.any():
            raise StateError(f"the state's {name} in world {int(wrong.argmax())} is not of {number.distribution!r:.80}")
    if wrong_words := wrongly_given(layout, layout.columns(block, Given).words):
        raise StateError(f"the state's {wrong_words}")


def _refusal(what: str, rows: slice | Array, values: Array, bad: Array, needed: str) -> StateError:
    """Return the error for the first of the `bad` values."""
    w, k, *rest = (int(index) for index in np.argwhere(bad)[0])
    row = k + (rows.start or 0) if isinstance(rows, slice) else int(rows[k])
    return StateError(f"the state's {what} is {values[w, k, *rest]} in world {w}, row {row}: {needed}")
