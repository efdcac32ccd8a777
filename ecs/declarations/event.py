"""Events: lists of the happenings of a tick, which systems write and any code can read.

    class Hit(Event, capacity="hits"):
        agent: Array = column("i4", unit="entity")
        amount: Array = column("i4", unit="hit points")

    k = emit(hits)  # in a system with the parameter hits: Write[Hit]
    hits.agent[k], hits.amount[k] = me, damage

The engine empties all lists of a world at the start of its next tick, STEP or RESET, before any system runs. Later
systems of the tick, and code that runs between two ticks, find the events of that tick, in the order of systems.
"""

from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils

from ..kernels.errors import CapacityError, DeclarationError
from ..kernels.integers import is_whole
from ..kernels.jit import intrinsic, kernel
from .component import Column, Component, Singleton, snake_case, table_type

COUNT = "count"
TIMES = ("world", "episode", "tick")  # the fields that `entries` adds

Array = np.ndarray[Any, Any]


class Event(Singleton, packed=False):
    """A list of at most `capacity` entries for each world and tick. Columns are declared with the shape of one entry.

    In a world, a column has shape (capacity, ...), and `count`, int32 (1,), is the number of entries; values after them
    have no meaning. A column of unit "entity" holds a row, of "side" a side, of "damage type" its number; -1 is none.

    Attributes:
        name: The class's name in snake case, unique in a scenario.
        capacity: A size, the name of a dimension, or a component: one entry for each entity that has it.
        who: The column of the acting entity in tables of all events: `agent`, if it holds integers of unit
            "entity" or of none, unless the class names another.
        whom: The column of the entity acted upon: `target`, under the same conditions.

    Raises:
        DeclarationError: The class has no columns or no capacity, or a name that is not allowed.
    """

    count: Any  # added by the engine
    name: ClassVar[str] = ""
    capacity: ClassVar[int | str | type[Component]] = 0
    who: ClassVar[str] = ""
    whom: ClassVar[str] = ""

    def __init_subclass__(
        cls, capacity: int | str | type[Component] | None = None, who: str = "agent", whom: str = "target"
    ) -> None:
        super().__init_subclass__()
        own = f"class {cls.__name__}(Event)"
        if not cls.columns:
            raise DeclarationError(
                f'{own} has no columns: declare one, as in agent: Array = column("i4", unit="entity")'
            )
        if capacity is None:
            raise DeclarationError(
                f'{own} has no capacity: give the maximum number in a tick, as in (Event, capacity="agents")'
            )
        given: Any = capacity
        kind = isinstance(given, type) and issubclass(given, Component)
        if not (is_whole(given, 1) or isinstance(given, str) or kind):
            raise DeclarationError(
                f"{own} with the capacity {capacity!r:.60}: an integer >= 1, the name of a dimension or a "
                "component is needed"
            )
        if taken := sorted({COUNT, *TIMES} & cls.columns.keys()):
            raise DeclarationError(f"{own}: the column '{taken[0]}' is reserved for the engine; rename yours")
        entities = [name for name, column in cls.columns.items() if _holds_entities(column)]
        for role, column in (("who", who), ("whom", whom)):
            if column not in (*cls.columns, "agent", "target"):
                raise DeclarationError(f"{own}: {role}={column!r} is not one of its columns: {', '.join(cls.columns)}")
            if column not in (*entities, "agent", "target"):
                raise DeclarationError(
                    f"{own}: {role}={column!r} must hold entities; declare it as "
                    f'{column}: Array = column("i4", unit="entity")'
                )
        cls.name, cls.capacity = snake_case(cls.__name__), capacity
        cls.who, cls.whom = (role if role in entities else "" for role in (who, whom))
        below = f"{cls.capacity_dim()} + 1"
        cls.columns = cls.columns | {COUNT: Column(np.dtype(np.int32), (), 0, -np.inf, np.inf, below=below)}
        cls.Table = table_type(cls)

    @classmethod
    def row_shape(cls, name: str, dims: dict[str, int]) -> tuple[int, ...]:
        """Return the shape of a column in one world: (capacity, ...), of the count (1,)."""
        return (1,) if name == COUNT else (dims[cls.capacity_dim()], *cls.columns[name].shape(dims))

    @classmethod
    def capacity_dim(cls) -> str:
        """Return the name of the dimension in which a layout stores the capacity."""
        return f"capacity of {cls.name}"


def _holds_entities(column: Column) -> bool:
    """Return whether a column holds rows of entities, or may do so, as it has no unit."""
    return column.dtype.kind in "iu" and not column.dims and column.unit in ("entity", "")


@kernel
def emit(events: Any) -> int:
    """Reserve the next entry of an event's list, with 0 in all columns, and return its index.

    Args:
        events: The event's table: a parameter annotated Write[...].

    Raises:
        CapacityError: The list is full.
    """
    k = events.count[0]
    events.count[0] = k + 1  # a count above the capacity marks the full list for `overflow`
    if k >= events[0].shape[0]:
        raise CapacityError("the list of an event is full")
    zero_entry(events, k)
    return int(k)


def _zero(events: Any, k: int) -> None:
    for column in events[:-1]:
        column[k] = 0


@intrinsic(_zero)
def zero_entry(typing: Any, events: Any, k: Any) -> Any:
    """Set all columns of an event's entry to 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        for number, kind in enumerate(signature.args[0].types[:-1]):
            column = context.make_array(kind)(context, builder, builder.extract_value(arguments[0], number))
            size = builder.extract_value(column.strides, 0)
            start = builder.add(builder.ptrtoint(column.data, size.type), builder.mul(arguments[1], size))
            cgutils.memset(builder, builder.inttoptr(start, cgutils.voidptr_t), size, 0)
        return context.get_dummy_value()

    return types.void(events, types.intp), generate


def memory_type(events: Iterable[type[Event]], dims: dict[str, int]) -> np.dtype[Any]:
    """Return the type of one world's events: all columns. Numbers of events are stored apart; see `EventMemory`."""
    columns: list[Any] = [
        (f"{event.name}.{name}", event.columns[name].dtype, event.row_shape(name, dims))
        for event in events
        for name in event.columns
        if name != COUNT
    ]
    return np.dtype(columns or [("nothing", np.int32)], align=True)


class EventMemory(NamedTuple):
    """The events of some worlds.

    Attributes:
        counts: int32 (worlds, kinds), number of events of each kind; counts of all worlds are adjacent, so that
            looking for events loads few cache lines.
        lists: The events themselves, (worlds,) of `memory_type`.
    """

    counts: Array
    lists: Array

    def of(self, where: Any) -> "EventMemory":
        """Return the events of the worlds `where`, a mask or a slice; copied for a mask."""
        return EventMemory(self.counts[where], self.lists[where])


@kernel
def clear(counts: Any) -> None:
    """Empty the lists of one world; their entries do not change until `emit` reserves them again.

    Args:
        counts: int32, number of events of each kind.
    """
    for k in range(counts.size):
        counts[k] = 0


def zero_unused(kinds: Iterable[type[Event]], memory: EventMemory) -> None:
    """Set the entries after the last one of each list to 0: their old content is not part of a state."""
    for k, event in enumerate(kinds):
        for name in event.columns:
            if name != COUNT:
                column = memory.lists[f"{event.name}.{name}"]
                column[np.arange(column.shape[1]) >= memory.counts[:, k : k + 1]] = 0


def table(event: type[Event], kinds: tuple[type[Event], ...], memory: EventMemory) -> Any:
    """Return the table of an event in the memory of some worlds."""
    k = kinds.index(event)
    columns = (memory.lists[f"{event.name}.{name}"] for name in event.columns if name != COUNT)
    return event.Table(*columns, memory.counts[:, k : k + 1])


def entries(
    event: type[Event], kinds: tuple[type[Event], ...], memory: EventMemory, times: tuple[Array, Array, Array]
) -> Array:
    """Return a copy of the events of one kind in the memory of some worlds.

    Args:
        event: The kind.
        kinds: All kinds, in the order of the memory.
        memory: The memory of these worlds.
        times: The number of each of these worlds, its episode and its tick, integers (worlds,) each.

    Returns:
        A structured array with a row for each event, in order of worlds: `world`, `episode` and `tick`, int64, and the
        event's columns. Empty if `event` is not among `kinds`.
    """
    names = [name for name in event.columns if name != COUNT]
    if event not in kinds:
        types = [(name, np.dtype(np.int64)) for name in TIMES]
        types += [(name, event.columns[name].dtype) for name in names]
        return np.empty(0, types)
    rows = table(event, kinds, memory)
    count = rows.count[:, 0]
    where = np.repeat(np.arange(len(count)), count)
    entry = np.arange(len(where)) - np.repeat(np.cumsum(count) - count, count)
    parts = {name: part[where].astype(np.int64) for name, part in zip(TIMES, times, strict=True)}
    parts |= {name: getattr(rows, name)[where, entry] for name in names}
    found = np.empty(len(where), [(name, part.dtype, part.shape[1:]) for name, part in parts.items()])
    for name, part in parts.items():
        found[name] = part
    return found


def overflow(kinds: tuple[type[Event], ...], memory: EventMemory) -> tuple[int, type[Event], int] | None:
    """Return world, event and capacity of a list that overflowed in a call of `emit`, and fix its count; or None."""
    for event in kinds:
        rows = table(event, kinds, memory)
        capacity = rows[0].shape[1]
        full = rows.count[:, 0] > capacity
        if full.any():
            rows.count[full] = capacity
            return int(full.argmax()), event, capacity
    return None


def capacity_error(
    kinds: tuple[type[Event], ...], memory: EventMemory, systems: Iterable[Any], ticks: Array
) -> CapacityError | None:
    """Return the error for the list that overflowed; None without an overflow.

    Args:
        kinds: All kinds, in the order of the memory.
        memory: The events of all worlds.
        systems: The systems of the tick; the message names the emitters.
        ticks: The tick of each world, integers (worlds,).
    """
    if (found := overflow(kinds, memory)) is None:
        return None
    w, kind, most = found
    writers = [s for s in systems if ("write", (kind,)) in ((p.kind, p.components) for p in s.parameters)]
    if isinstance(kind.capacity, str):
        cure = (
            f"its capacity is the dimension '{kind.capacity}', to which every mechanic adds its number of events, "
            f"as in def dims(self): return {{'{kind.capacity}': 'agents'}}"
        )
    elif isinstance(kind.capacity, int):
        cure = f"give it a larger one, as in class {kind.__name__}(Event, capacity={2 * most + 1})"
    else:
        cure = f"its capacity is one for each entity with {kind.capacity.__name__}; declare a larger one if needed"
    return CapacityError(
        f"world {w}, tick {int(ticks[w])}: more than {most} of the event {kind.__name__}, which "
        f"{' and '.join(system.label for system in writers)} {'emits' if len(writers) == 1 else 'emit'}: {cure}"
    )
