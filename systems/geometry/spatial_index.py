"""A spatial index: which rows are near a place, tested 64 at a time; for rooms with hundreds of bodies.

The AABBs of all rows are rounded outwards to a grid of 255 steps along each axis, so that each of their four sides is
a byte, and lie side by side. A query compares the sides of 64 rows with those of a rectangle in four instructions.

    index = blocks, sides, scale, words, rows    # scratch memory of a mechanic, see make_scratch
    build(index, count, aabbs)                   # of `count` lines of `blocks`
    for k in range(query(index, count, low_x, high_x, low_y, high_y)):
        e = rows[k]

The result has every row whose AABB overlaps the rectangle, in order, and others that are a step away.
"""

from typing import Any, TypeAlias

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.simd import (
    BYTES,
    LARGEST,
    NO_BYTE,
    SIMD_SHIFT,
    SIMD_WIDTH,
    load,
    overlap,
    store_bytes,
    trailing_zeros,
)

from .aabb import AABBs, make_half_extents
from .blocks import BITS, BLOCK, first_row, make_blocks

Index: TypeAlias = tuple[Array, Array, Array, Array, Array]
"""Blocks, sides, scale, words, rows; see `make_scratch`."""

FEW = 8  # if there are no more blocks than this, testing each is faster
LOW_X, HIGH_X, LOW_Y, HIGH_Y = range(4)  # lines of `sides`
START, STEPS = 0, 1  # of each axis in `scale`: where the first step begins, and how many steps a metre has
X, Y = 0, 1  # axes
ROWS = 4  # of an Index: what the last query has found
EVERY = (1 << SIMD_WIDTH) - 1  # all rows of a block
ZERO, ONE, LAST = np.float32(0), np.float32(1), np.float32(LARGEST)
PART = np.float32(1e-6)  # of coordinates: more than float32 loses


def make_scratch(name: str, dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Make any scratch memory of a mechanic that looks for bodies.

    half_extents: see `aabb`; sides: uint8 (4, rows), line by line as the index has them, not as the tables do; scale:
    float32 (axes, 2); words: int64 (2, words), bitsets of near rows and where in `sides` each begins; rows: int32, what
    is near; any other name: a list of blocks, see `blocks`.
    """
    words = -(-dims["blocks"] * SIMD_WIDTH // BYTES)
    if name == "half_extents":
        return make_half_extents(dims)
    if name == "sides":
        return np.zeros((4, BYTES * words), np.uint8)
    if name == "scale":
        return np.ones((2, 2), np.float32)
    if name == "words":
        return np.zeros((2, words + 1), np.int64)
    return np.zeros(SIMD_WIDTH * dims["blocks"], np.int32) if name == "rows" else make_blocks(dims)


@kernel
def build(index: Index, count: int, aabbs: AABBs) -> None:
    """Build the index of the rows in the `count` lines of blocks, at least one; `aabbs` are those of all rows."""
    blocks, sides, scale, _, _ = index
    xs, ys, half_x, half_y = aabbs
    slack_x, slack_y = fit(scale[X], blocks, count, xs), fit(scale[Y], blocks, count, ys)
    for k in range(count):
        row, to, bits = SIMD_WIDTH * blocks[BLOCK, k], SIMD_WIDTH * k, blocks[BITS, k]
        at, reach = load(xs, row) - scale[X, START], load(half_x, row) + slack_x
        store_bytes(sides[LOW_X], to, (at - reach) * scale[X, STEPS], bits)  # NO_BYTE for others: they overlap nothing
        store_bytes(sides[HIGH_X], to, (at + reach) * scale[X, STEPS], EVERY)
        at, reach = load(ys, row) - scale[Y, START], load(half_y, row) + slack_y
        store_bytes(sides[LOW_Y], to, (at - reach) * scale[Y, STEPS], EVERY)
        store_bytes(sides[HIGH_Y], to, (at + reach) * scale[Y, STEPS], EVERY)
    for e in range(SIMD_WIDTH * count, -(-SIMD_WIDTH * count // BYTES) * BYTES):  # the rest of the last word
        sides[LOW_X, e] = NO_BYTE


@kernel
def fit(scale: Array, blocks: Array, count: int, centres: Array) -> Real:
    """Let the steps of an axis cover the range of the lines' first rows; return the slack of coordinates, metres.

    What lies beyond belongs to the first or the last step.
    """
    low = high = centres[first_row(blocks[BLOCK, 0], blocks[BITS, 0])]
    for k in range(1, count):
        at = centres[first_row(blocks[BLOCK, k], blocks[BITS, k])]
        low, high = min(low, at), max(high, at)
    scale[START], scale[STEPS] = low, LAST / max(high - low, ONE)
    return PART * (abs(low) + abs(high) + ONE)


@kernel
def step(scale: Array, at: Real) -> Any:
    """Return the step of a coordinate."""
    k = (at - scale[START]) * scale[STEPS]
    k = k if k > ZERO else ZERO  # also for NaN
    return np.uint8(np.int32(k if k < LAST else LAST))


@kernel
def query(index: Index, count: int, low_x: Real, high_x: Real, low_y: Real, high_y: Real) -> int:
    """List in `rows` those whose AABB may overlap a rectangle, in order; return how many."""
    blocks, sides, scale, words, rows = index
    first_x, last_x = step(scale[X], low_x), step(scale[X], high_x)
    first_y, last_y = step(scale[Y], low_y), step(scale[Y], high_y)
    some = 0
    for start in range(0, SIMD_WIDTH * count, BYTES):  # without a branch, which would often be mispredicted
        bits = overlap(sides[LOW_X], sides[HIGH_X], start, first_x, last_x)
        bits &= overlap(sides[LOW_Y], sides[HIGH_Y], start, first_y, last_y)
        words[BITS, some], words[BLOCK, some] = bits, start
        some += bits != 0
    found = k = 0
    pending = words[BITS, 0]
    while k < some:  # one loop over the rows of all words, as its end is mispredicted
        at = words[BLOCK, k] + trailing_zeros(pending)
        rows[found] = SIMD_WIDTH * blocks[BLOCK, at >> SIMD_SHIFT] + (at & SIMD_WIDTH - 1)
        found += 1
        pending &= pending - 1
        done = pending == 0
        k += done
        pending = words[BITS, k] if done else pending
    return found
