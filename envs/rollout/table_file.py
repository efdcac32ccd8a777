"""Files with one long table, of episodes or events, .csv or .parquet, written row by row; complete or not there."""

import contextlib
import csv
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from outlast.ecs import MemoryLayout

from ..core.spaces import statistics
from ..core.validation import Array, joined
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError, install
from ..inspect.event_table import COLUMNS, event_table
from ..storage.interrupts import interrupts_held
from ..storage.outputs import atomic_write, check_file, written_to
from .against import PLAYED, Against
from .summary import MOMENTS, column_names

Table = Mapping[str, Array]
Result = TypeVar("Result")
# called with info, and with the worlds in which an ended episode counts
Ended = Callable[[Mapping[str, Any], Array], Result]

ENDINGS = (".csv", ".parquet")  # of the files that tables can be written to
EVENTS = {"world": "int64", "episode": "int64", "tick": "int64", "amount": "float64"}  # Arrow's types of columns
EPISODES = {"world": "int64", "episode": "int64", "own_side": "int64"}  # the same; statistics have their own
ROWS = 100_000  # rows kept in memory, and written together


class TableFile:
    """A file that rows are added to. Ctrl-C leaves no incomplete row."""

    def __init__(self, writer: "_Csv | _Parquet") -> None:
        self._writer = writer
        self._waiting: list[Table] = []

    def add(self, table: Table) -> None:
        """Add rows: arrays by the names of the columns."""
        self._waiting.append(table)
        if sum(len(next(iter(table.values()))) for table in self._waiting) >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the rows that are still waiting."""
        with interrupts_held():
            if self._waiting:
                tables, self._waiting = self._waiting, []
                self._writer.write(joined(tables))


@contextlib.contextmanager
def table_file(path: str, what: str, columns: Sequence[str], types: Mapping[str, str]) -> Iterator[TableFile]:
    """Open a new file for a table. In the end it is complete, or not there.

    Args:
        path: NAME.csv or NAME.parquet.
        what: What the rows are, for messages: "events".
        columns: Names of the columns.
        types: Arrow's names of the types in a .parquet file, by column; the others hold text.

    Raises:
        UsageError: The ending is another one, the file exists, the folder does not, the disk is full, or pyarrow is
            missing for .parquet. If another process has made the file, the rows are in a file with a number
            in its name, which the error names.
    """
    target = check_table(path, what)
    errors, held = written_to(path, UsageError, f"; there are no {what}"), contextlib.ExitStack()
    with errors, held, atomic_write(target, new=True) as place, place.open("wb") as file:
        writer = _Csv(file, columns) if target.suffix == ".csv" else _Parquet(file, columns, types)
        table = TableFile(writer)
        yield table
        held.enter_context(interrupts_held())  # Ctrl-C waits until the file is in its place
        table.flush()
        writer.close()


@contextlib.contextmanager
def event_file(path: str, layout: MemoryLayout, first_world: int = 0) -> Iterator[Callable[..., None]]:
    """Open a new file NAME.csv or NAME.parquet for events, with COLUMNS of inspect.event_table; see `table_file`.

    Yields:
        A function that adds the events of a step, as returned by env.events(), of some worlds, bool (worlds,).
    """
    with table_file(path, "events", list(COLUMNS), EVENTS) as table:
        yield lambda events, where: table.add(event_table(layout, events, first_world, where))


def numbered(env: SurvivalVectorEnv, numbers: Array, against: Against | None = None) -> Ended[dict[str, Array]]:
    """Make a function that extracts the episodes that count from info.

    It returns `world`, `episode` (of the world, from 1), with others what Against.played returns, and all statistics by
    name, (episodes,) or (episodes, n); masked arrays if some episodes lack agents or sides.

    numbers: Number of the episode that each world is in, from 1, int (worlds,).
    """

    def rows(info: Mapping[str, Any], where: Array) -> dict[str, Array]:
        worlds, there = np.flatnonzero(where), info.get("statistics_present", {})
        found = {key: values[worlds] for key, values in info["statistics"].items()}
        masked = {key: np.ma.array(found[key], mask=~present[worlds]) for key, present in there.items()}
        played = against.played(worlds) if against else {}
        return {"world": worlds + env.first_world, "episode": numbers[worlds]} | played | found | masked

    return rows


def _cells(values: Array) -> Array:
    """Return the cells of a table with these values: empty where they are masked."""
    return np.ma.filled(values.astype(object), "") if np.ma.isMaskedArray(values) else values


@contextlib.contextmanager
def episode_file(
    path: str, env: SurvivalVectorEnv, numbers: Array, against: Against | None = None
) -> Iterator[Ended[None]]:
    """Open a new file for the episodes of a rollout; see `numbered` and `table_file`.

    Columns are `world`, `episode` (of the world, from 1), with others those of Against.played, and the statistics in
    alphabetical order. A statistic with an entry per agent or side has a column for each (return_0, return_1), which is
    empty if the episode had no such agent or side; that of a moment (first_death) is empty if it never came. Rows are
    in the order in which episodes end.

    Yields:
        A function that adds a row for each episode that counts.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    types = {name: none[key].dtype.name for key in keys for name in column_names(key, none[key])}
    rows = numbered(env, numbers, against)
    firsts = ["world", "episode", *(PLAYED if against else ())]
    with table_file(path, "episodes", [*firsts, *types], EPISODES | types) as table:

        def add(info: Mapping[str, Any], where: Array) -> None:
            if where.any():
                own = rows(info, where)
                own |= {key: np.ma.masked_equal(own[key], 0) for key in keys if key in MOMENTS}
                columns = [column for key in keys for column in _cells(own[key]).reshape(where.sum(), -1).T]
                table.add({name: own[name] for name in firsts} | dict(zip(types, columns, strict=True)))

        yield add


def check_table(path: str | os.PathLike[str], what: str) -> Path:
    """Return the path of a new table, if it can be written. For arguments and errors see `table_file`."""
    target = check_file(path, what, UsageError, endings=ENDINGS, new=True)
    if target.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise UsageError(f"{target}: .parquet files need pyarrow: {install('data')}")
    return target


class _Csv:
    """A writer of UTF-8 with a row of headings; lines end as in RFC 4180."""

    def __init__(self, file: BinaryIO, columns: Sequence[str]) -> None:
        self._file, self._columns = file, columns
        self._rows([tuple(columns)])

    def write(self, table: Table) -> None:
        self._rows(zip(*(table[name].tolist() for name in self._columns), strict=True))

    def close(self) -> None:
        pass

    def _rows(self, rows: Any) -> None:
        text = io.StringIO()
        csv.writer(text).writerows(rows)
        self._file.write(text.getvalue().encode())


class _Parquet:
    """A writer of columns of the given types, others as text; null where a CSV file is empty."""

    def __init__(self, file: BinaryIO, columns: Sequence[str], types: Mapping[str, str]) -> None:
        import pyarrow as pa  # here, as it is optional
        import pyarrow.parquet as pq

        kinds = [(name, pa.type_for_alias(types.get(name, "string"))) for name in columns]
        self._arrow, self._schema = pa, pa.schema(kinds)
        self._writer = pq.ParquetWriter(file, self._schema, compression="zstd")

    def write(self, table: Table) -> None:
        columns = {
            name: [None if value == "" else value for value in table[name].tolist()] for name in self._schema.names
        }
        self._writer.write_table(self._arrow.table(columns, schema=self._schema))

    def close(self) -> None:
        self._writer.close()
