"""A file of events: one long table, .csv or .parquet, written while worlds are stepped."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from outlast.ecs import MemoryLayout

from ..inspect.event_table import COLUMNS, event_table
from .table_file import TableFile, table_file

Array = np.ndarray[Any, Any]

TYPES = {"world": "int64", "episode": "int64", "tick": "int64", "amount": "float64"}


class EventFile:
    """A file that events are added to."""

    def __init__(self, layout: MemoryLayout, table: TableFile, first_world: int) -> None:
        self._layout, self._table, self._first_world = layout, table, first_world

    def add(self, events: Mapping[str, Array], where: Array | None = None) -> None:
        """Add the events of a step, as returned by env.events(), of the worlds `where`, bool (worlds,)."""
        self._table.add(event_table(self._layout, events, self._first_world, where))


@contextlib.contextmanager
def event_file(path: str, layout: MemoryLayout, first_world: int = 0) -> Iterator[EventFile]:
    """Open a new file for events, in the end complete or not there. Columns: see inspect.event_table.COLUMNS.

    Args:
        path: NAME.csv or NAME.parquet.
        layout: The layout of the worlds.
        first_world: Number of the first world.

    Raises:
        UsageError: See table_file.
    """
    with table_file(path, "events", list(COLUMNS), TYPES) as table:
        yield EventFile(layout, table, first_world)
