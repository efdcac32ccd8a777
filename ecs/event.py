"""Events: what happened in a tick, as lists that systems write and everybody reads.

    class Hit(Event, capacity="hits"):
        agent: Array = column("i4", unit="entity")
        amount: Array = column("i4", unit="hit points")

    k = emit(hits)  # in a system with the parameter hits: Write[Hit]
    hits.agent[k], hits.amount[k] = me, damage

The engine empties all lists of a world at the start of its next tick, STEP or RESET, before any system runs. So systems
that run later in the tick, and everybody between two ticks, find the events of that tick, in the order of systems.
"""

from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np

from .component import Column, Component, Singleton, snake_case, table_type
from .errors import CapacityError, DeclarationError
from .jit import kernel

COUNT = "count"
WORD = 4  # bytes
TIMES = ("world", "episode", "tick")  # the fields that `entries` adds

Array = np.ndarray[Any, Any]


class Event(Singleton, packed=False):
    """A list of at most `capacity` entries for each world and tick. Columns are declared with the shape of one entry.

    In a world, a column has shape (capacity, ...), and `count`, int32 (1,), says how many entries there are; what lies
    behind them is 0. Unit "entity": a row, "side": a side, "damage type": its number; -1: none.

    Attributes:
        name: The class's name in snake case, unique in a scenario.
        capacity: A size, the name of a dimension, or a component: one entry for each entity that has it.
        who: The column with the entity that did it, in tables of all events: `agent`, unless the class says otherwise.
        whom: The column with the entity to which it was done: `target`, likewise.

    Raises:
        DeclarationError: It has no columns, no capacity, or names that cannot be.
    """

    count: Any  # the column that the engine adds
    name: ClassVar[str] = ""
    capacity: ClassVar[int | str | type[Component]] = 0
    who: ClassVar[str] = ""
    whom: ClassVar[str] = ""

    def __init_subclass__(
        cls, capacity: int | str | type[Component] | None = None, who: str = "agent", whom: str = "target"
    ) -> None:
        cls.columns = {}
        super().__init_subclass__(packed=False)
        own = f"class {cls.__name__}(Event)"
        if not cls.columns:
            raise DeclarationError(
                f'{own} has no columns: declare one, as in agent: Array = column("i4", unit="entity")'
            )
        if capacity is None:
            raise DeclarationError(
                f'{own} has no capacity: say how many there can be in a tick, as in (Event, capacity="agents")'
            )
        if taken := sorted({COUNT, *TIMES} & cls.columns.keys()):
            raise DeclarationError(f"{own}: the engine has a column '{taken[0]}' of its own; call yours otherwise")
        for role, column in (("who", who), ("whom", whom)):
            if column not in (*cls.columns, "agent", "target"):
                raise DeclarationError(f"{own}: {role}={column!r} is none of its columns: {', '.join(cls.columns)}")
        cls.name, cls.capacity = snake_case(cls.__name__), capacity
        cls.who, cls.whom = (role if role in cls.columns else "" for role in (who, whom))
        cls.columns = cls.columns | {COUNT: Column(np.dtype(np.int32), (), 0, -np.inf, np.inf)}
        cls.Table = table_type(cls)

    @classmethod
    def row_shape(cls, name: str, dims: dict[str, int]) -> tuple[int, ...]:
        """Shape of a column in one world: (capacity, ...), of the count (1,)."""
        return (1,) if name == COUNT else (dims[cls.capacity_dim()], *cls.columns[name].shape(dims))

    @classmethod
    def capacity_dim(cls) -> str:
        """The dimension by which a layout keeps the capacity as a number."""
        return f"capacity of {cls.name}"


@kernel
def emit(events: Any) -> int:
    """Reserve the next entry of an event's list, and return its index.

    Args:
        events: The table, a parameter annotated Write[...]. Its columns are 0 at that index.

    Raises:
        CapacityError: The list is full.
    """
    k = events.count[0]
    events.count[0] = k + 1  # one too many says which list it was: see `overflow`
    if k >= events[0].shape[0]:
        raise CapacityError("the list of an event is full")
    return int(k)


def memory_type(events: Iterable[type[Event]], dims: dict[str, int]) -> np.dtype[Any]:
    """The memory of one world's events: how many there are of each kind, side by side, and all columns."""
    kinds = tuple(events)
    columns = [
        (f"{event.name}.{name}", event.columns[name].dtype, event.row_shape(name, dims))
        for event in kinds
        for name in event.columns
        if name != COUNT
    ]
    return np.dtype([(COUNT, np.int32, (max(1, len(kinds)),)), *columns], align=True)


def list_spans(events: Iterable[type[Event]], memory: np.dtype[Any]) -> Array:
    """For `clear`: int32 (kinds, 2), the words from which and up to which the columns of each kind lie in memory."""
    fields: Any = memory.fields
    found = []
    for event in events:
        places = [fields[f"{event.name}.{name}"] for name in event.columns if name != COUNT]
        stops = [start + kind.itemsize for kind, start in places]
        found.append((places[0][1] // WORD, -(-max(stops) // WORD)))
    return np.array(found, np.int32).reshape(-1, 2)


@kernel
def clear(memory: Any, spans: Any) -> None:
    """Empty the lists of one world. A list that has been empty is 0 anyway, so only the others are written.

    Args:
        memory: int32 words; they begin with the counts.
        spans: See `list_spans`.
    """
    for k in range(spans.shape[0]):
        if memory[k] > 0:
            memory[k] = 0
            for word in range(spans[k, 0], spans[k, 1]):
                memory[word] = 0


def table(event: type[Event], kinds: tuple[type[Event], ...], memory: Array) -> Any:
    """The table of an event in the memory of some worlds, (worlds,) of `memory_type`."""
    k = kinds.index(event)
    columns = (memory[f"{event.name}.{name}"] for name in event.columns if name != COUNT)
    return event.Table(*columns, memory[COUNT][:, k : k + 1])


def entries(
    event: type[Event], kinds: tuple[type[Event], ...], memory: Array, times: tuple[Array, Array, Array]
) -> Array:
    """The events of a kind in the memory of some worlds, copied.

    Args:
        event: The kind.
        kinds: All of them, in the order of the memory.
        memory: (worlds,) of `memory_type`.
        times: Number of each of these worlds, its episode and its tick, integers (worlds,) each.

    Returns:
        A structured array with a row for each event, in order of worlds: `world`, `episode` and `tick`, int64, and the
        event's columns. Empty for a kind that is none of them.
    """
    names = [name for name in event.columns if name != COUNT]
    if event not in kinds:
        types = [(name, np.dtype(np.int64)) for name in TIMES]
        types += [(name, event.columns[name].dtype) for name in names]
        return np.empty(0, types)
    rows = table(event, kinds, memory)
    count = rows.count[:, 0]
    where = np.repeat(np.arange(len(memory)), count)
    entry = np.arange(len(where)) - np.repeat(np.cumsum(count) - count, count)
    parts = {name: part[where].astype(np.int64) for name, part in zip(TIMES, times, strict=True)}
    parts |= {name: getattr(rows, name)[where, entry] for name in names}
    found = np.empty(len(where), [(name, part.dtype, part.shape[1:]) for name, part in parts.items()])
    for name, part in parts.items():
        found[name] = part
    return found


def overflow(kinds: tuple[type[Event], ...], memory: Array) -> tuple[int, type[Event], int] | None:
    """World, event and capacity of the list to which `emit` could not add; its count is put right. None: no such."""
    for event in kinds:
        rows = table(event, kinds, memory)
        capacity = rows[0].shape[1]
        full = rows.count[:, 0] > capacity
        if full.any():
            rows.count[full] = capacity
            return int(full.argmax()), event, capacity
    return None
