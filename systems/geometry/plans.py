"""Rectangles of a layout in plain Python: where they reach, which overlap, and what floor they leave.

A rectangle is a tuple of numbers: x and y of its middle, width, height (metres), angle (radians), and maybe more.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

Rectangle = Sequence[float]
STEP = 0.25  # metres between the points by which free floor is measured


def corners(rectangle: Rectangle) -> list[complex]:
    """Its corners, counter-clockwise."""
    x, y, width, height, angle = rectangle[:5]
    turn = complex(math.cos(angle), math.sin(angle))
    return [complex(x, y) + turn * complex(a * width, b * height) / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def reach(rectangle: Rectangle) -> tuple[float, float]:
    """How far from the origin it reaches along x and along y, metres."""
    points = corners(rectangle)
    return max(abs(point.real) for point in points), max(abs(point.imag) for point in points)


def overlap(one: Rectangle, two: Rectangle) -> bool:
    """Whether two rectangles have floor in common; touching is none (a separating-axis test)."""
    for angle in (one[4], one[4] + math.pi / 2, two[4], two[4] + math.pi / 2):
        axis = complex(math.cos(angle), -math.sin(angle))
        first, second = ([(point * axis).real for point in corners(each)] for each in (one, two))
        if max(first) <= min(second) + 1e-6 or max(second) <= min(first) + 1e-6:
            return False
    return True


def free_floor(
    blocks: Iterable[Rectangle], sides: tuple[float, float], radius: float, step: float = STEP
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Where the centre of a disc can be.

    Args:
        blocks: What is in the way.
        sides: Width and height of the room, metres.
        radius: Of the disc, metres.
        step: Metres between points.

    Returns:
        x float64 (1, columns) and y float64 (rows, 1), metres; and whether a disc there touches nothing, bool
        (rows, columns).
    """
    x, y = (np.arange(-(n := math.floor((side / 2 - radius) / step)), n + 1) * step for side in sides)
    xs, ys = x[None, :], y[:, None]
    free = np.ones((len(y), len(x)), bool)
    for middle_x, middle_y, width, height, angle in (block[:5] for block in blocks):
        cosine, sine = math.cos(angle), math.sin(angle)
        along = abs(cosine * (xs - middle_x) + sine * (ys - middle_y)) - width / 2
        across = abs(cosine * (ys - middle_y) - sine * (xs - middle_x)) - height / 2
        free &= np.hypot(np.maximum(along, 0), np.maximum(across, 0)) > radius
    return xs, ys, free


def inside(rectangle: Rectangle, x: Any, y: Any) -> Any:
    """Which points are in a rectangle."""
    middle_x, middle_y, width, height, angle = rectangle[:5]
    cosine, sine = math.cos(angle), math.sin(angle)
    along, across = cosine * (x - middle_x) + sine * (y - middle_y), cosine * (y - middle_y) - sine * (x - middle_x)
    return (abs(along) <= width / 2) & (abs(across) <= height / 2)


def parts(free: np.ndarray[Any, Any]) -> int:
    """Into how many parts free floor falls, points beside each other being connected: bool (rows, columns)."""
    left, count = free.copy(), 0
    while left.any():
        count += 1
        ahead = [tuple(np.argwhere(left)[0])]
        left[ahead[0]] = False
        while ahead:
            row, column = ahead.pop()
            for to in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                if 0 <= to[0] < left.shape[0] and 0 <= to[1] < left.shape[1] and left[to]:
                    left[to] = False
                    ahead.append(to)
    return count
