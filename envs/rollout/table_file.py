"""Tables of episodes, or of events of all kinds, and their files, .csv or .parquet, which are complete or not there."""

import codecs
import contextlib
import csv
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from outlast.ecs import DeclarationError, Event, MemoryLayout
from outlast.ecs.declarations.event import COUNT, TIMES

from ..core.spaces import statistics
from ..core.validation import Array, joined
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError, install
from ..storage.interrupts import interrupts_held
from ..storage.outputs import atomic_write, check_file, written_to
from .lineup import PLAYED, Against
from .summary import MOMENTS, column_names

Table = Mapping[str, Array]
Result = TypeVar("Result")
# called with info, and with the worlds in which an ended episode counts
Ended = Callable[[Mapping[str, Any], Array], Result]

ENDINGS = (".csv", ".parquet")  # of the files that tables can be written to
COLUMNS = {  # of tables of events
    "world": "number of the world",
    "episode": "number of the world's episode, from 1",
    "tick": "of the episode, from 1; in tick 0 it starts",
    "event": "what happened, as in env.events()",
    "who": "the acting entity, as 'agent 1'; empty: none",
    "whom": "the entity acted upon, as 'box 3'",
    "amount": "how much; empty: it has none",
    "why": "the damage type",
    "more": "the event's other columns, as 'item=heal 3 side=1'",
}
EVENTS = {"world": "int64", "episode": "int64", "tick": "int64", "amount": "float64"}  # Arrow's types of columns
EPISODES = {"world": "int64", "episode": "int64", "own_side": "int64"}  # the same; statistics have their own
ROWS = 100_000  # rows kept in memory, and written together


@contextlib.contextmanager
def table_file(
    path: str, what: str, columns: Sequence[str], types: Mapping[str, str]
) -> Iterator[Callable[[Table], None]]:
    """Open a new file for a table, and yield a function that adds rows: arrays by the names of the columns.

    In the end the file is complete, or not there. Ctrl-C leaves no incomplete row. Raises UsageError if it cannot be
    written. If another process has made it, the rows are in a file with a number in its name, which the error names.

    path: NAME.csv or NAME.parquet. what: What the rows are, for messages: "events". types: Arrow's names of the types
    in a .parquet file, by column; the others hold text.
    """
    target, waiting = check_table(path, what), list[Table]()

    def flush() -> None:
        with interrupts_held():
            tables = waiting[:]
            waiting.clear()
            writer.write(joined(tables))

    def add(table: Table) -> None:
        waiting.append(table)
        if sum(len(next(iter(each.values()))) for each in waiting) >= ROWS:
            flush()

    errors, held = written_to(path, UsageError, f"; there are no {what}"), contextlib.ExitStack()
    with errors, held, atomic_write(target, new=True) as place, place.open("wb") as file:
        writer = (_Csv if target.suffix == ".csv" else _Parquet)(file, columns, types)
        yield add
        held.enter_context(interrupts_held())  # Ctrl-C waits until the file is in its place
        if waiting:
            flush()
        writer.close()


@contextlib.contextmanager
def event_file(path: str, layout: MemoryLayout, first_world: int = 0) -> Iterator[Callable[..., None]]:
    """Open a new file for events, and yield a function that adds those of a step, env.events(), in some worlds."""
    with table_file(path, "events", list(COLUMNS), EVENTS) as add:
        yield lambda events, where: add(event_table(layout, events, first_world, where))


def numbered(env: SurvivalVectorEnv, numbers: Array, against: Against | None = None) -> Ended[dict[str, Array]]:
    """Return a function from info to the columns of Summary.arrays. numbers: Of each world's episode, from 1."""

    def rows(info: Mapping[str, Any], where: Array) -> dict[str, Array]:
        worlds, there = np.flatnonzero(where), info.get("statistics_present", {})
        found = {key: values[worlds] for key, values in info["statistics"].items()}
        masked = {key: np.ma.array(found[key], mask=~present[worlds]) for key, present in there.items()}
        played = against.played(worlds) if against else {}
        return {"world": worlds + env.first_world, "episode": numbers[worlds]} | played | found | masked

    return rows


@contextlib.contextmanager
def episode_file(
    path: str, env: SurvivalVectorEnv, numbers: Array, against: Against | None = None
) -> Iterator[Ended[None]]:
    """Open a new file for the episodes of a rollout, and yield a function that adds those that count.

    Columns are `world`, `episode` (of the world, from 1), with others those of Against.played, and the statistics in
    alphabetical order. A statistic with an entry per agent or side has a column for each (return_0, return_1), which is
    empty if the episode had no such agent or side; that of a moment (first_death) is empty if it never came. Rows are
    in the order in which episodes end. See `numbered` and `table_file`.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    types = {name: none[key].dtype.name for key in keys for name in column_names(key, none[key])}
    rows = numbered(env, numbers, against)
    firsts = ["world", "episode", *(PLAYED if against else ())]
    with table_file(path, "episodes", [*firsts, *types], EPISODES | types) as add:

        def add_episodes(info: Mapping[str, Any], where: Array) -> None:
            if where.any():
                own = rows(info, where)
                own |= {key: np.ma.masked_equal(own[key], 0) for key in keys if key in MOMENTS}
                masked = {key: values for key, values in own.items() if np.ma.isMaskedArray(values)}
                own |= {key: np.ma.filled(values.astype(object), "") for key, values in masked.items()}
                columns = [column for key in keys for column in own[key].reshape(where.sum(), -1).T]
                add({name: own[name] for name in firsts} | dict(zip(types, columns, strict=True)))

        yield add_episodes


def check_table(path: str | os.PathLike[str], what: str) -> Path:
    """Return the path of a new table, if it can be written. For arguments and errors see `table_file`."""
    target = check_file(path, what, UsageError, endings=ENDINGS, new=True)
    if target.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise UsageError(f"{target}: .parquet files need pyarrow: {install('data')}")
    return target


class _Csv:
    """A writer of UTF-8 with a row of headings; lines end as in RFC 4180."""

    def __init__(self, file: BinaryIO, columns: Sequence[str], types: Mapping[str, str]) -> None:
        self._rows, self._columns = csv.writer(codecs.getwriter("utf-8")(file)), columns
        self._rows.writerow(columns)

    def write(self, table: Table) -> None:
        self._rows.writerows(zip(*(table[name].tolist() for name in self._columns), strict=True))

    def close(self) -> None:
        pass


class _Parquet:
    """A writer of columns of the given types, others as text; null where a CSV file is empty."""

    def __init__(self, file: BinaryIO, columns: Sequence[str], types: Mapping[str, str]) -> None:
        import pyarrow as pa  # here, as it is optional
        import pyarrow.parquet as pq

        schema = pa.schema([(name, pa.type_for_alias(types.get(name, "string"))) for name in columns])
        self._table = partial(pa.table, schema=schema)
        self._writer, self._columns = pq.ParquetWriter(file, schema, compression="zstd"), columns
        self.close = self._writer.close

    def write(self, table: Table) -> None:
        columns = {name: [None if value == "" else value for value in table[name].tolist()] for name in self._columns}
        self._writer.write_table(self._table(columns))


def with_episodes(events: dict[str, Array], episodes: Array) -> dict[str, Array]:
    """Replace the column `episode` of events (by name) with each world's number in `episodes`, int (worlds,)."""
    # the clock's own number of an episode starts again whenever a seed, or a level with a key, is given
    for rows in events.values():
        rows["episode"] = episodes[rows["world"]]
    return events


def event_table(
    layout: MemoryLayout, events: Mapping[str, Array], first_world: int = 0, where: Array | None = None
) -> dict[str, Array]:
    """Return one table of events, as env.events() returns them, of the worlds `where`, bool (worlds,), or of all.

    It has the columns COLUMNS: arrays of int64 or of objects (str; in `amount`, float or None), with an entry for each
    event. Events are ordered by world, then by kind, then as they happened.
    """
    kinds = {event.name: event for event in layout.events}
    parts = [_part(layout, kinds[name], rows) for name, rows in events.items()]
    table = {name: np.concatenate([part[name] for part in parts] or [np.empty(0, object)]) for name in COLUMNS}
    order = np.argsort(table["world"], kind="stable")
    if where is not None:
        order = order[where[table["world"][order].astype(np.intp)]]
    table = {name: column[order] for name, column in table.items()}
    table["world"] = table["world"] + first_world
    return table


def _part(layout: MemoryLayout, event: type[Event], rows: Array) -> dict[str, Array]:
    """Return the table of the events of one kind."""
    words, places = _words(layout), {event.who: "who", event.whom: "whom"}
    found: dict[str, Array] = {name: rows[name] for name in TIMES}
    nothing = {"event": event.name, "who": "", "whom": "", "amount": None, "why": "", "more": ""}
    found |= {name: np.full(len(rows), value, object) for name, value in nothing.items()}
    why = next((name for name, column in event.columns.items() if column.unit == "damage type"), None)
    for name, column in event.columns.items():
        if name == COUNT:
            continue
        values, unit = rows[name], "entity" if name in places else column.unit
        if unit in words:
            count = len(words[unit]) - 1
            if (wrong := values[(values < -1) | (values >= count)]).size:
                raise DeclarationError(
                    f"the event {event.__name__} has {name} = {wrong.flat[0]}, and its unit is {unit!r}: "
                    f"-1 to {count - 1} is possible; a system wrote something else"
                )
            values = words[unit][values]
        if name in places:
            found[places[name]] = values
        elif name == why:
            found["why"] = values
        elif name == "amount" and values.ndim == 1:
            found["amount"] = rows[name].astype(object)
        else:
            without = -1 if unit == "side" else ""
            texts = ["" if value == without else f" {name}={value}" for value in values.tolist()]
            found["more"] += np.array(texts, object)
    found["more"] = np.array([text.strip() for text in found["more"]], object)
    return found


@lru_cache(maxsize=16)
def _words(layout: MemoryLayout) -> dict[str, Array]:
    """Return the names of what columns of these units refer to, by number, and at the end "" for -1, which is none."""
    names = {"entity": layout.entity_names, "damage type": layout.labels["damage_type"]}
    return {unit: np.array([*each, ""], object) for unit, each in names.items()}
