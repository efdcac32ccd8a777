"""What follows a system from outside of outlast: a check that integers it may have written are in their columns' range.

Other systems take them for indices without looking, or as bits, so one that cannot be would read and write elsewhere.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from .component import Component, Singleton
from .errors import RangeError
from .jit import kernel
from .layout import Layout
from .system import System


@kernel
def check_range(values: Any, rows: Any, low: int, high: int) -> None:
    """RangeError unless all integers of these rows are in the range.

    values: (rows of the world, numbers of a row). rows: int32, those of entities that have the component.
    """
    for k in range(rows.size):
        for c in range(values.shape[1]):
            if values[rows[k], c] < low or values[rows[k], c] > high:
                raise RangeError("an integer is out of the range that its column declares")


def ranges(layout: Layout, system: System) -> Iterator[tuple[type[Component], str, int, int]]:
    """The columns to check behind a system, each with its lowest and highest integer."""
    for component in layout.components:
        if system.touches(component, "write", "add"):
            for name, column in component.columns.items():
                if column.dtype != bool and (ends := column.range(layout.dims)):
                    yield component, name, *ends


def checked_rows(layout: Layout, component: type[Component], name: str) -> np.ndarray[Any, Any]:
    """int32, those of entities that have the component; of a column of a Singleton, all."""
    if issubclass(component, Singleton):
        return np.arange(component.row_shape(name, layout.dims)[0], dtype=np.int32)
    return layout.rows(component)
