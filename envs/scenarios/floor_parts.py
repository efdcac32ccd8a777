"""The separate parts of a floor, between which a body of some size cannot move."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from outlast.systems.geometry.plans import Rectangle, are_free, connected, corners

from ..errors import ScenarioError

CELLS = 10  # points of the grid per diameter of the disc
MOST = 1000  # points along a side of the room at most; in larger rooms they are farther apart
LISTED = 4  # parts that a sentence lists at most


class Part(NamedTuple):
    """A part of the floor in which a disc can get everywhere, but which it cannot leave.

    Attributes:
        x: Position of a point in the part, near its middle, where the middle of the disc can be, metres.
        y: Its second coordinate, metres.
        area: The area that the middle of the disc can reach, square metres.
        starts: Indices of the start areas that overlap it.
    """

    x: float
    y: float
    area: float
    starts: tuple[int, ...]


def parts_of(
    walls: Iterable[Rectangle], starts: Sequence[Rectangle], width: float, room: tuple[float, float]
) -> list[Part]:
    """Return the parts of a floor, the largest first; see FloorPlan.parts.

    Args:
        walls: Rectangles (x, y, width, height, angle), metres and radians.
        starts: Rectangles of the start areas, in the same form.
        width: The diameter of the disc, metres.
        room: Width and height of the floor, metres.

    Raises:
        ScenarioError: Width or room is missing, or lattice points would be farther apart than the disc's radius.
    """
    step = max(width / CELLS, max(room) / MOST)
    if not (width > 0 and min(room) > 0 and step <= width / 2):
        raise ScenarioError(
            f"parts: a disc of {width:g} m on a floor of {room[0]:g} x {room[1]:g} m; a diameter from a "
            f"{MOST // 2}th of the floor's longer side on is needed"
        )
    counts = [math.ceil(side / step) for side in room]
    x, y = np.meshgrid(*(((np.arange(n) + 0.5) / n - 0.5) * side for n, side in zip(counts, room, strict=True)))
    cell = room[0] * room[1] / math.prod(counts)
    free = are_free(x, y, (), room, width / 2)
    for wall in walls:
        ends = np.array(corners(wall))
        near = _around(y[:, 0], ends.imag, width), _around(x[0], ends.real, width)
        free[near] &= are_free(x[near], y[near], [wall], room, width / 2)
    labels = connected(free)
    inside = [_is_in(area, x, y) for area in starts]
    found = [_part(x, y, labels == n, inside, cell) for n in range(1, int(labels.max(initial=0)) + 1)]
    return sorted(found, key=lambda part: -part.area)


def in_words(parts: Sequence[Part], owners: Sequence[float | str], width: float) -> str:
    """Return a text that a floor has several parts, where they are and who starts there; "" if there is at most one.

    Args:
        parts: See `parts_of`.
        owners: Who starts in each start area: a side, or "items".
        width: The diameter of the disc, metres.
    """
    if len(parts) < 2:
        return ""
    listed = []
    for part in parts[:LISTED]:
        who = sorted({"items" if owners[k] == "items" else f"side {owners[k]}" for k in part.starts})
        there = f", where {' and '.join(who)} start" if who else ""
        listed.append(f"{part.area:.3g} square metres around ({part.x:.3g}, {part.y:.3g}){there}")
    more = [f"{len(parts) - LISTED} more"] * (len(parts) > LISTED)
    return f"agents {width:.3g} m wide cannot get from one part of the floor to another: {'; '.join(listed + more)}"


def _around(points: Any, ends: Any, margin: float) -> slice:
    """Return the slice of the sorted points along an axis that are between the ends, or up to `margin` beyond them."""
    first, last = np.searchsorted(points, (ends.min() - margin, ends.max() + margin))
    return slice(int(first), int(last))


def _is_in(area: Rectangle, x: Any, y: Any) -> Any:
    """Return which points are in a rectangle, bool of the shape of x and y."""
    turned = ((x - area[0]) + 1j * (y - area[1])) * np.exp(-1j * area[4])
    return (abs(turned.real) <= area[2] / 2) & (abs(turned.imag) <= area[3] / 2)


def _part(x: Any, y: Any, own: Any, inside: Sequence[Any], cell: float) -> Part:
    """Return the part that consists of the points `own`. cell: square metres that each of them stands for."""
    xs, ys = x[own], y[own]
    middle = int(np.hypot(xs - xs.mean(), ys - ys.mean()).argmin())
    starts = tuple(k for k, area in enumerate(inside) if (area & own).any())
    return Part(float(xs[middle]), float(ys[middle]), float(own.sum()) * cell, starts)
