"""Strips: which rows are near a place, without examining every row; for rooms with hundreds of bodies.

The room is cut into strips along x and along y. Each strip has two bitsets: the rows that begin in it or before it, and
those that end in it or after it. A row whose AABB overlaps a rectangle begins in or before the rectangle's last strip,
and ends in or after its first one, along both axes: a conjunction of four bitsets.

    fill_strips(strips, extent, blocks, count, aabbs)
    count = rows_near(blocks, strips, extent, low_x, high_x, low_y, high_y)

The result has every such row, and others that are a strip away.
"""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.simd import SIMD_WIDTH, load, to_bits

from .aabb import AABBs, make_half_extents
from .blocks import BITS, BLOCK, first_row, make_blocks

FEW = 16  # if there are no more blocks than this, testing each is faster
STRIPS = 16  # along each axis
BEGIN, END = 0, 1  # indices into `strips`, which has the axes (axis, BEGIN or END, strip, block)
X, Y = 0, 1
ZERO, ONE, LAST = np.float32(0), np.float32(1), np.float32(STRIPS - 1)
SHARE, PART = np.float32(0.01), np.float32(1e-6)  # slack, of a strip and of coordinates: more than float32 loses


def make_strips(dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Make scratch memory for the bitsets: int32 (axes, 2, strips, blocks); none if there are FEW blocks."""
    return np.zeros((2, 2, STRIPS, dims["blocks"] if dims["blocks"] > FEW else 0), np.int32)


def make_extent() -> np.ndarray[Any, Any]:
    """Make scratch memory for the strips' places: float32 (axes, 2), where the first begins, and the width of each."""
    return np.ones((2, 2), np.float32)


def make_scratch(name: str, dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Make any scratch memory of a mechanic that looks for bodies: half_extents, strips, extent or a list of blocks."""
    if name == "extent":
        return make_extent()
    made = {"half_extents": make_half_extents, "strips": make_strips}
    return made.get(name, make_blocks)(dims)


@kernel
def strip(extent: Array, axis: int, at: Real) -> int:
    """Return the strip of a coordinate; one beyond all strips belongs to the first or the last one."""
    k = (at - extent[axis, 0]) / extent[axis, 1]
    k = k if k > ZERO else ZERO  # also for NaN
    return int(k if k < LAST else LAST)


@kernel
def fill_strips(strips: Array, extent: Array, blocks: Array, count: int, aabbs: AABBs) -> None:
    """Sort the rows of `count` lines of `blocks` into strips, which cover the range of the lines' first rows."""
    xs, ys, half_x, half_y = aabbs
    for s in range(STRIPS):
        for b in range(strips.shape[3]):
            strips[X, BEGIN, s, b] = 0  # so blocks that have no line are never near
    sort_rows(strips[X], extent, X, blocks, count, xs, half_x)
    sort_rows(strips[Y], extent, Y, blocks, count, ys, half_y)


@kernel
def sort_rows(strips: Array, extent: Array, axis: int, blocks: Array, count: int, centres: Array, half: Array) -> None:
    """Sort rows into the strips of one axis."""
    low = high = centres[first_row(blocks[BLOCK, 0], blocks[BITS, 0])]
    for k in range(1, count):
        at = centres[first_row(blocks[BLOCK, k], blocks[BITS, k])]
        low, high = min(low, at), max(high, at)
    width = max(high - low, ONE) / np.float32(STRIPS)
    extent[axis, 0], extent[axis, 1] = low, width
    slack = SHARE * width + PART * (abs(low) + abs(high))
    for k in range(count):
        b, bits = blocks[BLOCK, k], blocks[BITS, k]
        at, reach = load(centres, SIMD_WIDTH * b), load(half, SIMD_WIDTH * b) + slack
        first, last = at - reach, at + reach
        for s in range(STRIPS - 1):
            edge = low + np.float32(s + 1) * width  # between strip s and the next one
            strips[BEGIN, s, b] = to_bits(first <= edge) & bits
            strips[END, s + 1, b] = to_bits(last >= edge) & bits
        strips[BEGIN, STRIPS - 1, b] = strips[END, 0, b] = bits


@kernel
def rows_near(blocks: Array, strips: Array, extent: Array, low_x: Real, high_x: Real, low_y: Real, high_y: Real) -> int:
    """List in `blocks` the rows whose AABB may overlap a rectangle; return how many lines."""
    first_x, last_x = strip(extent, X, low_x), strip(extent, X, high_x)
    first_y, last_y = strip(extent, Y, low_y), strip(extent, Y, high_y)
    for b in range(strips.shape[3]):
        x_too = strips[X, BEGIN, last_x, b] & strips[X, END, first_x, b]
        blocks[BITS, b] = x_too & strips[Y, BEGIN, last_y, b] & strips[Y, END, first_y, b]
    count = 0
    for b in range(strips.shape[3]):  # a loop of its own, so that the one before becomes SIMD instructions
        bits = blocks[BITS, b]
        blocks[BITS, count], blocks[BLOCK, count] = bits, b
        count += bits != 0
    return count
