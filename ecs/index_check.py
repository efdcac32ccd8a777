"""Indices of entities: a row is the place of an entity in all tables, an index its place among some entities.

Where agents have the first rows, the two are the same, so that a mechanic that confuses them works until another one
brings entities that come before.
"""

from typing import Any

import numpy as np

from .abstract_values import UNKNOWN, Column, Member, Shared, Slice
from .component import Singleton


def wrong_index(layout: Any, target: Column | Shared, index: Any) -> str:
    """Find an index that selects another entity's number in these worlds, or none.

    Args:
        layout: The ecs.layout.Layout of the worlds.
        target: What is indexed: a column, or a selection of entities.
        index: The abstract value of the index.

    Returns:
        What is wrong with it, for an error; "" for nothing that is sure.
    """
    parts = index if isinstance(index, tuple) else (frozenset([index]),)
    for dim, part in zip(_dims(layout, target), parts, strict=False):
        value = next(iter(part)) if len(part) == 1 else UNKNOWN
        if isinstance(value, Slice):
            break
        if isinstance(value, Member) and (wrong := _wrong(layout, dim, value)):
            return f"indexes {target}, {wrong}"
    return ""


def _dims(layout: Any, target: Column | Shared) -> tuple[int | str, ...]:
    """The dimensions of a whole column or a selection; () for anything else."""
    if isinstance(target, Shared):
        if target.kind == "rows":
            return (len(layout.rows(*target.components)),)
        return ("rows",) if target.kind == "row_index" else ()
    if target.part:
        return ()
    own = target.component.columns[target.name].dims
    return own if issubclass(target.component, Singleton) else ("rows", *own)


def _wrong(layout: Any, dim: int | str, value: Member) -> str:
    """What is wrong with an index of a dimension, and how to cure it; "" for nothing."""
    rows, size = layout.rows(*value.components), layout.dims[dim] if isinstance(dim, str) else dim
    alike = np.array_equal(rows, np.arange(len(rows)))  # whether the rows are 0, 1, 2, ...
    listed = f"Rows[{', '.join(component.__name__ for component in value.components)}]"
    if size == layout.dims["rows"]:
        wrong = value.what == "index" and not alike
        return f"which is by row, with an index in {listed}: take the row, which {listed} has there" if wrong else ""
    has = f"which has {size} ('{dim}')" if isinstance(dim, str) else f"which has {size}"
    if value.what == "row" and not alike:
        return f"{has}, with a row of {listed}: take an index in that list, as range(its size) or RowIndex has it"
    if len(rows) <= size:
        return ""
    kinds = ", ".join(name for name, span in layout.spans.items() if {*span} & {*rows.tolist()})
    cure = "narrow the list by another component" + (f", or add to '{dim}' in dims()" if isinstance(dim, str) else "")
    return f"{has}, with an index in {listed}, which has {len(rows)} ({kinds}): {cure}"
