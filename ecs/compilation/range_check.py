"""The check that follows a system from outside of outlast: integers it wrote must be in the range of their columns.

Other systems use them as indices or bits without a check, so an impossible one would make them read and write memory
that is not meant.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..declarations.component import Component, Singleton
from ..declarations.system import System
from ..kernels.errors import RangeError
from ..kernels.jit import kernel
from ..memory.layout import MemoryLayout


@kernel
def check_range(values: Any, rows: Any, low: int, high: int) -> None:
    """Raise RangeError unless all integers of these rows are in the range.

    Args:
        values: A column of integers, (rows of the world, numbers of a row).
        rows: The rows to check, int32, see `checked_rows`.
        low: The lowest integer that is allowed.
        high: The highest one.
    """
    for k in range(rows.size):
        for c in range(values.shape[1]):
            if values[rows[k], c] < low or values[rows[k], c] > high:
                raise RangeError("an integer is out of the range that its column declares")


def ranges(layout: MemoryLayout, system: System) -> Iterator[tuple[type[Component], str, int, int]]:
    """The columns to check after a system: component, name, and the lowest and the highest integer of each."""
    for component in layout.components:
        if system.touches(component, "write", "add"):
            for name, column in component.columns.items():
                if column.dtype != bool and (ends := column.range(layout.dims)):
                    yield component, name, *ends


def checked_rows(layout: MemoryLayout, component: type[Component], name: str) -> np.ndarray[Any, Any]:
    """The rows to check, int32: those of entities that have the component; of a column of a Singleton, all rows."""
    if issubclass(component, Singleton):
        return np.arange(component.row_shape(name, layout.dims)[0], dtype=np.int32)
    return layout.rows(component)
