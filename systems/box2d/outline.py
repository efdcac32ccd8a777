"""Polygons of a contact batch: checks of their corners, and their transfer to Box2D by the native backend."""

import numpy as np
from numpy.typing import NDArray

from outlast.components.polygon import LEAST, MOST, SOUND, flaw
from outlast.ecs import kernel
from outlast.ecs.kernels.jit import noinline_kernel

from . import layout as at
from .batch import CORNER, CORNERS, LIMITS, X

_ZERO, _ONE = np.float32(0), np.float32(1)
_THIRD = np.float32(1) / np.float32(3)


@kernel
def whole(outlines: NDArray[np.float32], count: int) -> bool:
    """Return whether Box2D accepts the polygons of the bodies 0..count-1 unchanged."""
    for k in range(count):
        if outlines[k, CORNERS] == 0:
            continue
        if not (LEAST <= outlines[k, CORNERS] <= MOST):
            return False
        corners = int(outlines[k, CORNERS])
        x, y = outlines[k, CORNER::2], outlines[k, CORNER + 1 :: 2]
        for n in range(corners):
            if not (abs(x[n]) <= LIMITS[X] and abs(y[n]) <= LIMITS[X]):
                return False
            if x[n] > x[0] or (x[n] == x[0] and y[n] < y[0]):
                return False
        if flaw(x, y, corners)[0] != SOUND:
            return False
    return True


@noinline_kernel
def write_polygon(shape: int, outline: NDArray[np.float32]) -> None:
    """Write a b2PolygonShape, as b2PolygonShape::Set does for these corners."""
    corners = int(outline[CORNERS])
    at.store_i4(shape + at.POLYGON_COUNT, corners)
    area, middle_x, middle_y = _ZERO, _ZERO, _ZERO
    for k in range(corners):
        x, y = outline[CORNER + 2 * k], outline[CORNER + 2 * k + 1]
        following = CORNER + 2 * ((k + 1) % corners)
        next_x, next_y = outline[following], outline[following + 1]
        along_x, along_y = next_x - x, next_y - y
        scale = _ONE / np.float32(np.sqrt(along_y * along_y + along_x * along_x))
        at.store_f4(shape + at.POLYGON_VERTICES + 8 * k, x)
        at.store_f4(shape + at.POLYGON_VERTICES + 8 * k + 4, y)
        at.store_f4(shape + at.POLYGON_NORMALS + 8 * k, along_y * scale)
        at.store_f4(shape + at.POLYGON_NORMALS + 8 * k + 4, -along_x * scale)
        part = x * next_y - y * next_x  # of twice the area, which cancels out
        area += part
        middle_x += part * _THIRD * (x + next_x)
        middle_y += part * _THIRD * (y + next_y)
    at.store_f4(shape + at.POLYGON_CENTROID, middle_x * (_ONE / area))
    at.store_f4(shape + at.POLYGON_CENTROID + 4, middle_y * (_ONE / area))


@noinline_kernel
def restore_box(shape: int) -> None:
    """Restore the b2PolygonShape of a box, except the positions of its corners."""
    at.store_i4(shape + at.POLYGON_COUNT, 4)
    for number in range(8):
        at.store_f4(shape + at.POLYGON_NORMALS + 4 * number, _ZERO)
    at.store_f4(shape + at.POLYGON_NORMALS + 4, -_ONE)
    at.store_f4(shape + at.POLYGON_NORMALS + 8, _ONE)
    at.store_f4(shape + at.POLYGON_NORMALS + 20, _ONE)
    at.store_f4(shape + at.POLYGON_NORMALS + 24, -_ONE)
    at.store_f4(shape + at.POLYGON_CENTROID, _ZERO)
    at.store_f4(shape + at.POLYGON_CENTROID + 4, _ZERO)
