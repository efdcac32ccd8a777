"""Rectangles of a layout in plain Python: their extents, overlaps, and the free floor between them.

A rectangle is a tuple of numbers: x and y of its middle, width, height (metres), angle (radians), and perhaps more.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

Rectangle = Sequence[float]
POINTS = 100  # along either side of a rectangle: free floor is measured by these points


def corners(rectangle: Rectangle) -> list[complex]:
    """Return its corners, counter-clockwise."""
    x, y, width, height, angle = rectangle[:5]
    turn = complex(math.cos(angle), math.sin(angle))
    return [complex(x, y) + turn * complex(a * width, b * height) / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def reach(rectangle: Rectangle) -> tuple[float, float]:
    """Return its extents from the origin along x and along y, metres."""
    points = corners(rectangle)
    return max(abs(point.real) for point in points), max(abs(point.imag) for point in points)


def overlap(one: Rectangle, two: Rectangle) -> bool:
    """Return whether two rectangles overlap; touching does not count (a separating-axis test)."""
    for angle in (one[4], one[4] + math.pi / 2, two[4], two[4] + math.pi / 2):
        axis = complex(math.cos(angle), -math.sin(angle))
        first, second = ([(point * axis).real for point in corners(each)] for each in (one, two))
        if max(first) <= min(second) + 1e-6 or max(second) <= min(first) + 1e-6:
            return False
    return True


def lattice(rectangle: Rectangle, points: int = POINTS) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return points in the middles of equal parts of a rectangle: x and y, metres, float64 (points, points) each."""
    x, y, width, height, angle = rectangle[:5]
    share = (np.arange(points) + 0.5) / points - 0.5
    along, across = share[None, :] * width, share[:, None] * height
    cosine, sine = math.cos(angle), math.sin(angle)
    return x + cosine * along - sine * across, y + sine * along + cosine * across


def are_free(x: Any, y: Any, blocks: Iterable[Rectangle], sides: tuple[float, float], radius: float) -> Any:
    """Return whether a disc around each point touches no block and is inside the room: bool, of the shape of x and y.

    Args:
        x: Coordinates of the points, metres.
        y: Coordinates of the points along y, metres.
        blocks: The blocks.
        sides: Width and height of the room, metres.
        radius: Radius of the disc, metres.
    """
    free = (abs(x) + radius <= sides[0] / 2) & (abs(y) + radius <= sides[1] / 2)
    for middle_x, middle_y, width, height, angle in (block[:5] for block in blocks):
        cosine, sine = math.cos(angle), math.sin(angle)
        along = abs(cosine * (x - middle_x) + sine * (y - middle_y)) - width / 2
        across = abs(cosine * (y - middle_y) - sine * (x - middle_x)) - height / 2
        free &= np.hypot(np.maximum(along, 0), np.maximum(across, 0)) > radius
    return free


def connected(free: Any) -> Any:
    """Return the connected parts of a lattice, in which each free point is connected to its eight neighbours.

    Args:
        free: Whether each point is free, bool (rows, columns); others are in no part.

    Returns:
        The number of each point's part, from 1 on, int (rows, columns); 0 for points in no part.
    """
    first = np.diff(free, axis=1, prepend=False) & free
    runs = np.cumsum(first).reshape(free.shape) * free  # numbers of runs of free neighbours in a row
    label = np.arange(int(runs.max(initial=0)) + 1)
    shifted = (runs[:-1, :-1], runs[1:, 1:]), (runs[:-1, 1:], runs[1:, :-1]), (runs[:-1], runs[1:])
    pairs = np.concatenate([(one * label.size + two)[np.logical_and(one, two)] for one, two in shifted])
    one, two = np.divmod(np.unique(pairs), label.size)
    while True:
        low = np.minimum(label[one], label[two])
        lower = label.copy()
        np.minimum.at(lower, label[one], low)
        np.minimum.at(lower, label[two], low)
        lower = lower[lower]
        if (lower == label).all():
            break
        label = lower
    return np.unique(label, return_inverse=True)[1].reshape(label.shape)[runs]
