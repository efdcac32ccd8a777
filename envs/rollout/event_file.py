"""A file of events: one long table, .csv or .parquet, written while worlds are stepped."""

import contextlib
import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from outlast.ecs import Layout

from ..errors import UsageError, install
from ..inspect.event_table import COLUMNS, event_table
from ..storage.atomic_write import atomic_write
from ..storage.interrupts import interrupts_held

Array = np.ndarray[Any, Any]
Table = dict[str, Array]

ROWS = 100_000  # events that are kept in memory, and written together


class TableWriter(Protocol):
    """What writes the tables of a file."""

    def write(self, table: Table) -> None:
        """Write more rows."""

    def close(self) -> None:
        """Write what is left."""


class EventFile:
    """Events on their way into a file. Ctrl-C leaves no half row."""

    def __init__(self, layout: Layout, writer: TableWriter, first_world: int) -> None:
        self._layout, self._writer, self._first_world = layout, writer, first_world
        self._waiting: list[Table] = []

    def add(self, events: Mapping[str, Array], where: Array | None = None) -> None:
        """Add the events of a step, as env.events() returns them, of the worlds `where`, bool (worlds,)."""
        self._waiting.append(event_table(self._layout, events, self._first_world, where))
        if sum(len(table["world"]) for table in self._waiting) >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what waits."""
        with interrupts_held():
            if self._waiting:
                tables, self._waiting = self._waiting, []
                self._writer.write({name: np.concatenate([table[name] for table in tables]) for name in COLUMNS})


@contextlib.contextmanager
def event_file(path: str, layout: Layout, first_world: int = 0) -> Iterator[EventFile]:
    """A new file for events, which is whole or not there; columns: see inspect.event_table.COLUMNS.

    Args:
        path: NAME.csv or NAME.parquet.
        layout: Of the worlds.
        first_world: Number of the first world.

    Raises:
        UsageError: Another ending, a file that is there, no folder, a full disk, or no pyarrow for .parquet.
    """
    target = Path(path)
    if target.suffix not in (".csv", ".parquet"):
        raise UsageError(f"{path}: events are written as NAME.csv or NAME.parquet")
    if target.exists():
        raise UsageError(f"{path} exists; events overwrite nothing: give another name, or delete it")
    try:
        with atomic_write(target) as place, place.open("wb") as file:
            writer = _Csv(file) if target.suffix == ".csv" else _Parquet(file)
            events = EventFile(layout, writer, first_world)
            yield events
            with interrupts_held():
                events.flush()
                writer.close()
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}; there are no events") from error


class _Csv:
    """UTF-8, with a heading; lines end as RFC 4180 says."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._rows([tuple(COLUMNS)])

    def write(self, table: Table) -> None:
        self._rows(zip(*(table[name].tolist() for name in COLUMNS), strict=True))

    def close(self) -> None:
        pass

    def _rows(self, rows: Any) -> None:
        text = io.StringIO()
        csv.writer(text).writerows(rows)
        self._file.write(text.getvalue().encode())


class _Parquet:
    """Integers for world, episode and tick, a float for the amount, texts for the others; null where a CSV is empty."""

    def __init__(self, file: BinaryIO) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ModuleNotFoundError:
            raise UsageError(f".parquet files need pyarrow: {install('data')}") from None
        kinds = {"world": pa.int64(), "episode": pa.int64(), "tick": pa.int64(), "amount": pa.float64()}
        self._arrow, self._schema = pa, pa.schema([(name, kinds.get(name, pa.string())) for name in COLUMNS])
        self._writer = pq.ParquetWriter(file, self._schema, compression="zstd")

    def write(self, table: Table) -> None:
        columns = {
            name: [None if value == "" else value for value in table[name].tolist()] for name in self._schema.names
        }
        self._writer.write_table(self._arrow.table(columns, schema=self._schema))

    def close(self) -> None:
        self._writer.close()
