"""Prefab values: those with which entities and singletons begin an episode."""

from collections.abc import Mapping
from typing import Any

from ..kernels.errors import DeclarationError
from .component import Component, as_stored
from .references import index_of


def fill(table: Any, where: Any, part: Component, label: str, dims: Mapping[str, int]) -> None:
    """Write the prefab values of a component into a part of its table.

    Args:
        table: The columns of the component.
        where: The index of the part.
        part: The component with its values.
        label: What errors begin with.
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
                f"{label}.{name} begins as {value.tolist()!r:.60}: {ends[0]} to {ends[1]} is its range"
            )
        try:
            there[...] = value
        except ValueError:
            raise DeclarationError(
                f"{label}.{name}: a value of the shape {value.shape} is no prefab of {there.shape}"
            ) from None
