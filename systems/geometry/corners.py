"""Corners of rectangles and polygons, counter-clockwise in the body's own frame, metres."""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel

ZERO, ONE, FAR = np.float32(0), np.float32(1), np.float32(np.inf)


@kernel
def corner_count(polygons: Any, e: int) -> int:
    """Return the number of corners of body `e`, which is not a disc. polygons: the table `Read[Polygon] | None`."""
    if polygons is not None and polygons.corners[e] > 0:
        return int(polygons.corners[e])
    return 4


@kernel
def corner(shape: Array, polygons: Any, e: int, k: int) -> tuple[Real, Real]:
    """Return corner k of body `e`; k may be the number of corners, which is the first again."""
    if polygons is not None and polygons.corners[e] > 0:
        n = k if k < polygons.corners[e] else 0
        return polygons.x[e, n], polygons.y[e, n]
    width, height = shape.half_width[e], shape.half_height[e]
    return width if k in (1, 2) else -width, height if k in (2, 3) else -height


@kernel
def outline_gap(shape: Array, polygons: Any, e: int, x: Real, y: Real) -> Real:
    """Return the metres from the outline of body `e` to a point in its frame; inside, minus those to a side."""
    beyond, least = -FAR, FAR
    for k in range(corner_count(polygons, e)):
        from_x, from_y = corner(shape, polygons, e, k)
        to_x, to_y = corner(shape, polygons, e, k + 1)
        along_x, along_y, to_x, to_y = to_x - from_x, to_y - from_y, x - from_x, y - from_y
        square = along_x * along_x + along_y * along_y
        beyond = max(beyond, (to_x * along_y - to_y * along_x) / np.float32(np.sqrt(square)))
        part = min(max((to_x * along_x + to_y * along_y) / square, ZERO), ONE)
        to_x, to_y = to_x - part * along_x, to_y - part * along_y
        least = min(least, to_x * to_x + to_y * to_y)
    return beyond if beyond <= ZERO else np.float32(np.sqrt(least))
