"""Checks of indices: of entities, and of fields in the rows of an observation.

A row is the place of an entity in all tables, an index its place among some entities. Where agents have the first
rows, the two are the same, so that a mechanic that confuses them works until another one brings entities that come
before.
"""

from collections.abc import Collection
from typing import Any

import numpy as np

from ..declarations.component import Singleton
from ..memory.layout import MemoryLayout
from .abstract_values import FIELD, UNKNOWN, Column, Constant, Member, PerAgent, Place, Shared, Slice, parts_of


def wrong_index(layout: MemoryLayout, target: Any, index: Any) -> str:
    """Find an index that selects another entity's number in these worlds, or none.

    Args:
        layout: The layout of the worlds.
        target: The abstract value that is indexed: a column, a list of rows, or a number in which roles differ.
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


def wrong_field(offsets: Collection[str], target: Column, index: Any) -> str:
    """Find a write of a whole row, of a literal column or of another field, where Offsets say which ones are written.

    Args:
        offsets: The names of the system's Offsets for the column.
        target: What is written: a column, or a part of one.
        index: The abstract value of the index.

    Returns:
        What is wrong with it, for an error; "" for nothing that is sure.
    """
    count, last, _ = parts_of(index)
    start, stop = (last.start, last.stop) if isinstance(last, Slice) else (last, UNKNOWN)
    for end in (start, stop):
        if isinstance(end, Place) and end.beyond(end is stop):
            return f"writes {target} beside the {end.size} of {end.name}; take an Offset for each field"
    literal = isinstance(start, Constant)
    if offsets and target.axes < FIELD and (literal or target.axes + count < target.ndim):
        own = ", ".join(sorted(offsets))
        return f"writes {target} beside the fields of its Offsets ({own}); take an Offset for each field"
    return ""


def _dims(layout: MemoryLayout, target: Any) -> tuple[int | str, ...]:
    """The dimensions of a target; () for a part of a column, and for anything else."""
    if isinstance(target, Shared) and target.kind == "rows":
        return (len(layout.rows(*target.components)),)
    if isinstance(target, PerAgent) or (isinstance(target, Shared) and target.kind == "row_index"):
        return ("rows",)
    if not isinstance(target, Column) or target.part:
        return ()
    own = target.component.columns[target.name].dims
    return own if issubclass(target.component, Singleton) else ("rows", *own)


def _wrong(layout: MemoryLayout, dim: int | str, value: Member) -> str:
    """What is wrong with an index of a dimension, and how to cure it; "" for nothing."""
    rows, size = layout.rows(*value.components), layout.dims[dim] if isinstance(dim, str) else dim
    alike = np.array_equal(rows, np.arange(len(rows)))  # whether the rows are 0, 1, 2, ...
    listed = f"Rows[{', '.join(component.__name__ for component in value.components)}]"
    if size == layout.dims["rows"]:
        wrong = value.what == "index" and not alike
        return f"which is by row, with an index in {listed}: take the row, which {listed} has there" if wrong else ""
    has = f"which has {size} ('{dim}')" if isinstance(dim, str) else f"which has {size}"
    given = f"with {'a row of' if value.what == 'row' else 'an index in'} {listed}"
    if value.what == "row" and not alike:
        return f"{has}, {given}: take an index in that list, as range(its size) or RowIndex has it"
    if len(rows) <= size:
        return ""
    kinds = ", ".join(name for name, span in layout.spans.items() if {*span} & {*rows.tolist()})
    cure = "narrow the list by another component" + (f", or add to '{dim}' in dims()" if isinstance(dim, str) else "")
    return f"{has}, {given}, which has {len(rows)} ({kinds}): {cure}"
