"""What is made only once, with the worlds: a number on which it depends can neither change, vary, nor differ by role.

Kernels read numbers whenever they run. But tables, the schedule and the memory of systems stay as they are.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np


def reasons(layout: Any, there: Any, k: int, systems: bool = True) -> Iterator[str]:
    """Why worlds of one layout cannot go on with a mechanic of another one.

    Args:
        layout: A Layout.
        there: A layout that differs from it only in a number of the mechanic `k`.
        k: The index of the mechanic among the modules of both.
        systems: Whether the mechanic must have the same systems in both.
    """
    one, other = layout.modules[k], there.modules[k]
    if sized := [dim for dim, size in layout.dims.items() if there.dims.get(dim) != size]:
        yield f"it decides how large tables are ({', '.join(map(repr, sized))})"
    if there.places != layout.places:
        yield "it decides which components there are"
    if _parts(there) != _parts(layout):
        yield "it decides which entities have which components"
    own = {system.label: system for system in (*one.systems(), *other.systems())}
    if systems and [*one.systems()] != [*other.systems()]:
        yield "it decides which systems run"
    scratch = {p.name for system in own.values() for p in system.parameters if p.kind == "scratch"}
    if any(_shape(one.scratch(name, layout.dims)) != _shape(other.scratch(name, layout.dims)) for name in scratch):
        yield "it decides how much memory systems have"


def differences(places: Iterable[Any], images: Sequence[Any]) -> Iterator[tuple[Any, int, Any]]:
    """Find the entries of columns in which the states of worlds differ.

    Args:
        places: The memory.column_places.Place of every column.
        images: The states, uint8 (world_bytes,) each.

    Yields:
        The column's place, the entry's index in it, and what the states have there, (images,).
    """
    stacked = np.stack(images)
    for where in [each for each in places if each.offset >= 0]:
        values = stacked[:, where.offset : where.offset + where.nbytes].copy().view(where.dtype)
        for k in np.flatnonzero((values != values[0]).any(0)).tolist():
            yield where, k, values[:, k]


def _parts(layout: Any) -> dict[str, set[type[Any]]]:
    """The components of each kind of entities."""
    return {name: {type(part) for part in kind.parts} for name, kind in layout.archetypes.items()}


def _shape(memory: Any) -> Any:
    return (memory.dtype, memory.shape) if isinstance(memory, np.ndarray) else type(memory)
