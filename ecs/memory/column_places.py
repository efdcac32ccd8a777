"""Places of columns in the state of a world, and their first values."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..declarations.component import Component, as_stored, index_of
from ..kernels.errors import DeclarationError

ALIGN = 64  # bytes: a cache line


@dataclass(frozen=True)
class Place:
    """The place of a column: its shape in one world, and its offset in the state (-1: a buffer of its own)."""

    component: type[Component]
    name: str
    shape: tuple[int, ...]
    offset: int

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the column's elements."""
        return self.component.columns[self.name].dtype

    @property
    def nbytes(self) -> int:
        """The bytes of the column in one world."""
        return self.dtype.itemsize * math.prod(self.shape)

    def view(self, block: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Return the column (worlds, ...) of worlds whose states are `block`, uint8 (worlds, bytes)."""
        strides = (self.dtype.itemsize * math.prod(self.shape[k + 1 :]) for k in range(len(self.shape)))
        shape = (len(block), *self.shape)
        return np.ndarray(shape, self.dtype, block, self.offset, (block.strides[0], *strides))


def place_columns(components: Iterable[type[Component]], dims: dict[str, int]) -> tuple[list[Place], int]:
    """Return the places of all columns in a row, and the bytes of a state, a multiple of cache lines."""
    places, offset = list[Place](), 0
    for component in components:
        for name, column in component.columns.items():
            shape = component.row_shape(name, dims)
            if not component.packed:
                places.append(Place(component, name, shape, -1))
                continue
            offset = -(-offset // column.dtype.itemsize) * column.dtype.itemsize
            places.append(Place(component, name, shape, offset))
            offset += places[-1].nbytes
    return places, max(ALIGN, -(-offset // ALIGN) * ALIGN)


def fill(table: Any, where: Any, part: Component, label: str, dims: Mapping[str, int]) -> None:
    """Write the prefab values of a component into a part of its table.

    Args:
        table: The columns of the component.
        where: The index of the part.
        part: The component with its values.
        label: Beginning of errors.
        dims: The sizes of the scenario's dimensions.

    Raises:
        DeclarationError: A value does not fit its column's type or shape, or is out of its range.
    """
    for name, column in part.columns.items():
        there = getattr(table, name)[where]
        given = index_of(part.fills.get(name, column.fill), len(there))
        value = as_stored(f"{label}.{name}", column, given)
        if there.size and (ends := column.range(dims)) and not (ends[0] <= value.min() and value.max() <= ends[1]):
            raise DeclarationError(
                f"{label}.{name} begins as {value.tolist()!r:.60}: must be from {ends[0]} to {ends[1]}"
            )
        try:
            there[...] = value
        except ValueError:
            raise DeclarationError(
                f"{label}.{name}: the value has shape {value.shape}, but shape {there.shape} is required"
            ) from None
