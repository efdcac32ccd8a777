"""The state of worlds as plain arrays: snapshots that are restored, copied to other worlds, or saved in a file.

A State holds everything that determines the future of its worlds: their blocks of tables, the buffers of actions,
observations and signals, whether they run, and the events of their last tick. Worlds that continue from it are
bit-identical to worlds that never stopped.

A state is checked before it is restored: everything used as an index is in range, and booleans are 0 or 1. Compiled
kernels do not check indices: one out of range would read or write other memory. So outlast's own components declare the
range of columns that kernels or views use as an index, a length or a part of an address. Other columns do no harm, for
any content: they are only compared, counted or used in calculations.

Mechanics of your own should also declare the range of columns that hold an index. If they do not, these are not
checked, and you should only load states from people you trust:

    owner: Array = column("i4", fill=-1, unit="entity")   # a row, -1: none
    phase: Array = column("i4", low=0, high=7)

A valid state need not be one that can occur in a game: an item may be in two bags, or an agent in a wall.
"""

import functools
import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from outlast.components import Bag, Side, Sight
from outlast.ecs import Component, Entity, Event, MemoryLayout, Place, Singleton, Worlds
from outlast.ecs.declarations.event import COUNT, EventMemory, table, zero_unused
from outlast.ecs.memory.given import misfits, wrongly_given
from outlast.ecs.memory.numbers import Given, Varied

from ..errors import StateError
from ..scenarios.fingerprint import difference, fingerprint, is_fingerprint
from ..scenarios.scenario import Scenario
from ..storage import inputs
from ..storage.outputs import atomic_write

VERSION = 1
HEADER = "header"  # the entry of a file that describes the other entries, JSON as bytes

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, repr=False, eq=False)
class State:
    """The state of some worlds of a scenario.

    state[k], state[a:b] and state[mask] are states of some of these worlds.

    Attributes:
        scenario: The scenario's name and numbers, which must be the same where the state is restored.
        arrays: Arrays by name, with a row for each world.
    """

    scenario: dict[str, Any]
    arrays: dict[str, Array]

    def __len__(self) -> int:
        return len(self.arrays["world"])

    def __repr__(self) -> str:
        return f"State({self.scenario['name']!r}, num_worlds={len(self)})"

    def __eq__(self, other: object) -> bool:
        """Return whether the other is the same state of the same scenario, bit by bit."""
        if not isinstance(other, State):
            return NotImplemented
        return (self.scenario, _checksum(self.arrays)) == (other.scenario, _checksum(other.arrays))

    def __getitem__(self, which: Any) -> "State":
        which = which.item() if isinstance(which, np.ndarray) and not which.ndim else which
        if isinstance(which, (tuple, bool, np.bool_)) or which is None or np.ndim(which) > 1:
            raise IndexError(f"a state has one axis, its worlds: {which!r:.80} is not an index of it")
        if isinstance(which, (int, np.integer)) and not -len(self) <= which < len(self):
            raise IndexError(f"world {which} does not exist: the state is of {len(self)}")
        chosen = slice(which, which + 1 or None) if isinstance(which, (int, np.integer)) else which
        return State(self.scenario, {name: array[chosen].copy() for name, array in self.arrays.items()})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an uncompressed .npz file without pickle, with a version and a checksum; completely or not at all.

        Args:
            path: The file; an existing one is replaced.

        Raises:
            OSError: The file cannot be written.
        """
        header = {"version": VERSION, "scenario": self.scenario, "checksum": _checksum(self.arrays)}
        named: dict[str, Any] = {HEADER: np.frombuffer(json.dumps(header).encode(), np.uint8), **self.arrays}
        with atomic_write(Path(path)) as place, place.open("wb") as file:
            np.savez(file, **named)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "State":
        """Read a file of `save`. Values are checked when it is restored, as their ranges depend on the scenario.

        Args:
            path: The file.

        Raises:
            StateError: The file is not a saved state, is of another version, is damaged or cannot be read.
            FileNotFoundError: The file does not exist.
        """
        try:
            with open(path, "rb") as file:
                return read(file, os.fspath(path))
        except FileNotFoundError:
            raise
        except OSError as error:
            raise StateError(f"{os.fspath(path)} cannot be read: {error.strerror}") from None


def read(file: BinaryIO, name: str) -> State:
    """Read the state in a file; errors contain `name`. Raises StateError."""
    try:
        entries = inputs.zip_entries(file)
        arrays = {key.removesuffix(".npy"): inputs.npy_array(content) for key, content in entries.items()}
        header = json.loads(arrays.pop(HEADER).tobytes())
        version, scenario, checksum = (header[key] for key in ("version", "scenario", "checksum"))
    except KeyError as error:
        raise StateError(f"{name} is not a saved state: it has no {error}") from None
    except inputs.BROKEN_ZIP as error:
        raise StateError(f"{name} is not a saved state: {str(error) or type(error).__name__}") from None
    if version != VERSION:
        raise StateError(f"{name} has version {version!r:.20} of the format: this outlast reads version {VERSION}")
    if checksum != _checksum(arrays):
        raise StateError(f"{name} is damaged: its checksum does not fit")
    if "world" not in arrays or len({array.shape[:1] for array in arrays.values()}) != 1 or not arrays["world"].ndim:
        raise StateError(f"{name} is not a saved state: its arrays are not rows of the same worlds")
    if not is_fingerprint(scenario):
        raise StateError(f"{name} is not a saved state: it does not name its scenario")
    return State(scenario, arrays)


def snapshot(scenario: Scenario, worlds: Worlds, masks: dict[str, Array], where: Any) -> State:
    """Return the state of the worlds `where` (mask, indices or slice). masks: State of worlds besides their tables."""
    rows = _rows(worlds, where)
    arrays = {name: array[rows] for name, array in _arrays(worlds, masks).items()}
    counts, lists = (arrays[name] for name in _events(worlds))
    zero_unused(worlds.layout.events, EventMemory(counts, lists.view(worlds.layout.event_type).reshape(-1)))
    return State(fingerprint(scenario), arrays)


def restore(state: State, scenario: Scenario, worlds: Worlds, masks: dict[str, Array], where: Any) -> None:
    """Restore the worlds `where` from `state`, which has one world for each of them, or one for all.

    Raises StateError, before anything is written, if it is of another scenario or not valid.
    """
    if not isinstance(state, State):
        raise StateError(f"{state!r:.60} is not a State, as get_state() returns and State.load() reads")
    if other := difference(state.scenario, fingerprint(scenario)):
        raise StateError(f"the state is of another scenario {other}")
    rows = _rows(worlds, where)
    if len(np.unique(rows)) < len(rows):
        raise StateError(f"where = {where!r:.60} names a world twice; take each once, or a mask of bool")
    if len(state) not in (1, len(rows)):
        raise StateError(f"a state of {len(state)} worlds for {len(rows)} worlds: one, or as many, are needed")
    arrays = _arrays(worlds, masks)
    for name, array in arrays.items():
        given = state.arrays.get(name)
        if given is None or given.dtype != array.dtype or given.ndim < 1 or given.shape[1:] != array.shape[1:]:
            found = "missing" if given is None else f"{given.dtype} {given.shape[1:]} a world"
            raise StateError(f"the state's array '{name}' is {found}: {array.dtype} {array.shape[1:]} is needed")
        if len(given) != len(state):
            raise StateError(f"the state's array '{name}' is of {len(given)} worlds, and the state of {len(state)}")
    if not len(state):
        return
    _check(worlds.layout, {name: state.arrays[name] for name in arrays})
    _check_events(worlds.layout, *(state.arrays[name] for name in _events(worlds)))
    for name, array in arrays.items():
        array[rows] = state.arrays[name]


def _rows(worlds: Worlds, where: Any) -> Array:
    """Return the numbers of the worlds `where`. Raises StateError if it is neither a mask, indices nor a slice."""
    try:
        rows = np.atleast_1d(np.arange(worlds.count)[where])
    except IndexError as error:
        raise StateError(f"where = {where!r:.60} of {worlds.count} worlds: {error}") from None
    if rows.ndim > 1:
        raise StateError(f"where = {where!r:.60}: a mask, indices or a slice of worlds are needed")
    return rows


def _arrays(worlds: Worlds, masks: dict[str, Array]) -> dict[str, Array]:
    """Return all arrays of the state of the worlds, by name; they are not copied."""
    outside = {
        f"{component.__module__}.{component.__qualname__}.{name}": column
        for component in worlds.components
        if not (component.packed or issubclass(component, Event))
        for name, column in worlds[component]._asdict().items()
    }
    return {"world": worlds.block, **outside, **masks, **_events(worlds)}


def _events(worlds: Worlds) -> dict[str, Array]:
    """Return the counts of events and the bytes of their lists, under names that depend on the layout of events."""
    counts, lists = worlds.event_memory
    name = _events_name(worlds.layout)
    return {f"{name}.counts": counts, f"{name}.lists": lists.view(np.uint8).reshape(len(lists), -1)}


@functools.lru_cache(maxsize=16)
def _events_name(layout: MemoryLayout) -> str:
    form = hashlib.blake2b(repr(layout.event_type.descr).encode(), digest_size=4).hexdigest()
    return f"events.{form}"


def _checksum(arrays: dict[str, Array]) -> str:
    total = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        total.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        total.update(array.tobytes())
    return total.hexdigest()


def _check(layout: MemoryLayout, arrays: dict[str, Array]) -> None:
    """Raise StateError unless the arrays of a state, including "world", are valid in worlds of that layout."""
    for name, array in arrays.items():
        if array.dtype == bool and (array.view(np.uint8) > 1).any():
            raise StateError(f"the state's array '{name}' holds bytes that are neither 0 nor 1")
    block = np.ascontiguousarray(arrays["world"])
    started = arrays.get("started", np.ones(len(block), bool))
    for what, rows, values, bad, needed in _checked(layout, block, started):
        if bad.any():
            w, k, *rest = (int(index) for index in np.argwhere(bad)[0])
            row = k + (rows.start or 0) if isinstance(rows, slice) else int(rows[k])
            raise StateError(f"the state's {what} is {values[w, k, *rest]} in world {w}, row {row}: {needed}")


def _checked(
    layout: MemoryLayout, block: Array, started: Array
) -> Iterator[tuple[str, slice | Array, Array, Array, str]]:
    """Yield columns, their rows and values (worlds, rows, ...), which of them are not valid, and what is needed.

    Worlds that have not started are reset before anything runs in them, so they may hold initial values. Raises
    StateError for varied and given numbers that cannot have been drawn, as counts among them are used as indices.
    """
    for span in _spans(layout):
        values = span.values(block)
        if (bad := (values < span.low) | (values > span.last)).any():
            bad[~started] &= (values != span.values(layout.initial_image[None]))[~started]
            name = f"{span.place.component.__name__}.{span.place.name}"
            yield name, span.rows, values, bad, f"{span.low} to {span.last} is needed"
    if Bag in layout.components:
        bag, rows = layout.columns(block, Bag), _rows_with(layout, Bag)
        items, count = bag.items[:, rows], bag.count[:, rows]
        bad = (items < 0) & (np.arange(items.shape[2]) < count[..., None])
        yield "Bag.items", rows, items, bad, "a row is needed, as the slot is in use by Bag.count"
    if Sight in layout.components:
        visible = layout.columns(block, Sight).visible
        bad = visible & ~layout.bitset(Entity) != 0
        yield "Sight.visible", slice(None), visible, bad, "a set of existing rows is needed"
    identity = layout.columns(block, Entity).identity
    absent = np.zeros_like(identity, dtype=bool)
    if layout.keyed:
        words = layout.columns(block, Varied).words
        for name, number in layout.varied.items():
            wrong = started & misfits(number, layout, words[:, number.words])
            if wrong.any():
                world = int(wrong.argmax())
                raise StateError(f"the state's {name} in world {world} is not of {number.distribution!r:.80}")
            for kind in number.kinds:
                rows = np.array(layout.spans[kind])
                absent[:, rows] = rows - rows[0] >= words[:, number.start, None]
        if wrong_words := wrongly_given(layout, layout.columns(block, Given).words):
            raise StateError(f"the state's {wrong_words}")
    bad = started[:, None] & ((identity < 0) != absent)
    yield "Entity.identity", slice(None), identity, bad, "-1 is needed for absent entities, and only for these"
    if Side in layout.components:
        rows = layout.rows(Side)
        side = layout.columns(block, Side).side[:, rows]
        bad = started[:, None] & ((side < 0) != absent[:, rows])
        yield "Side.side", rows, side, bad, f"0 to {layout.dims['sides'] - 1} is needed"


def _check_events(layout: MemoryLayout, counts: Array, given: Array) -> None:
    """Raise StateError unless `given`, uint8 (worlds, bytes), has valid lists of `counts` events, (worlds, kinds)."""
    memory = EventMemory(counts, np.ascontiguousarray(given).view(layout.event_type).reshape(-1))
    for event in layout.events:
        found, capacity = table(event, layout.events, memory), layout.dims[event.capacity_dim()]
        if ((found.count < 0) | (found.count > capacity)).any():
            raise StateError(f"the state's {event.__name__}.count is not between 0 and {capacity}")
        for name, column in event.columns.items():
            if name != COUNT and (ends := column.range(layout.dims)) and found.count.any():
                values, (low, high) = getattr(found, name), ends
                used = np.arange(capacity) < found.count
                if (used & ((values < low) | (values > high)).reshape(*used.shape, -1).any(-1)).any():
                    raise StateError(f"the state's {event.__name__}.{name} is not between {low} and {high}")


class _Span(NamedTuple):
    """A column to check: its place in a world, the rows that count, and the smallest and largest number allowed."""

    place: Place
    rows: slice | Array
    low: int
    last: int

    def values(self, block: Array) -> Array:
        """Return the values of the column in blocks of worlds, uint8 (worlds, bytes): (worlds, rows, ...)."""
        column = self.place.view(block)
        return (column.view(np.uint8) if column.dtype == bool else column)[:, self.rows]


@functools.lru_cache(maxsize=16)
def _spans(layout: MemoryLayout) -> tuple[_Span, ...]:
    """Return the columns to check in worlds of that layout; cached, as a search restores single worlds very often."""
    found = []
    for place in layout.places:
        if place.offset >= 0 and (ends := place.component.columns[place.name].range(layout.dims)):
            found.append(_Span(place, _rows_with(layout, place.component), *ends))
    return tuple(found)


def _rows_with(layout: MemoryLayout, component: type[Component]) -> slice | Array:
    """Return the rows of entities that have the component: if they are adjacent a slice, which avoids a copy."""
    if issubclass(component, Singleton):
        return slice(None)
    rows = layout.rows(component)
    together = len(rows) > 0 and rows[-1] - rows[0] == len(rows) - 1
    return slice(int(rows[0]), int(rows[-1]) + 1) if together else rows
