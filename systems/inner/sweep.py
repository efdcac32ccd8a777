"""Sweeps: of sixteen rows at a time, who may be hit, seen or touched; most are ruled out in a few vector instructions.

Rays and contacts ask one body against all others, and nearly all answers are no. A sweep takes group `g` of the rows
(16 g to 16 g + 15) and returns a set, bit j for row 16 g + j: everybody of whom the answer may be yes, and few others.
Only those get the exact test. Every body counts as the upright rectangle around it, a little enlarged.

    crowd, count = enclose(extent, body, shape), populated(groups, entities, bodies)
    for k in range(count):
        g = groups[GROUP, k]
        left = groups[SET, k] & across(crowd, g, x, y, dx, dy)
        while left:
            e = row(g, left)
            left &= left - 1
"""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.simd import SIMD_SHIFT, SIMD_WIDTH, load, load_flags, store, to_bits, trailing_zeros

WIDE, TALL = 0, 1  # rows of `extent`: half sides along x and y, metres
SET, GROUP = 0, 1  # lines of `groups`: sets that are not empty, and of which group each is
SLACK = np.float32(1e-3)  # metres: more than float32 loses in a sweep, so that nobody is ruled out who is hit
ZERO = np.float32(0)


def make_extent(dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Scratch for `enclose`: float32 (2, rows), room for whole groups."""
    return np.zeros((2, SIMD_WIDTH * dims["blocks"]), np.float32)


def make_groups(dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Scratch for `populated`: int32 (2, blocks)."""
    return np.zeros((2, dims["blocks"]), np.int32)


@kernel
def row(g: int, left: int) -> int:
    """The first row of a set."""
    return int(SIMD_WIDTH * g + trailing_zeros(left))


@kernel
def without(left: int, g: int, e: int) -> int:
    """A set of group `g` less row `e`."""
    return left & ~(1 << (e & SIMD_WIDTH - 1)) if e >> SIMD_SHIFT == g else left


@kernel
def span(members: Array) -> tuple[int, int]:
    """The groups that have members: from the first up to, but not including, the second."""
    first, last = members.size, 0
    for g in range(members.size):
        if members[g]:
            first, last = min(first, g), g + 1
    return first, last


@kernel
def present(entities: Array, members: Array, g: int) -> int:
    """The living among `members` (sets of rows by group)."""
    return int(to_bits(load_flags(entities.alive, SIMD_WIDTH * g)) & members[g])


@kernel
def populated(groups: Array, entities: Array, members: Array) -> int:
    """List the groups where members live, and who; returns how many. Without a branch: nobody foresees the answers."""
    count = 0
    for g in range(members.size):
        groups[SET, count], groups[GROUP, count] = present(entities, members, g), g
        count += groups[SET, count] != 0
    return count


@kernel
def enclose(extent: Array, body: Array, shape: Array) -> tuple[Array, Array, Array, Array]:
    """Where everybody is now, for the sweeps below: centres, and half sides, which are written into `extent`."""
    for start in range(0, extent.shape[1], SIMD_WIDTH):
        cosine, sine = abs(load(body.cosine, start)), abs(load(body.sine, start))
        width, height = load(shape.half_width, start), load(shape.half_height, start)
        radius = load(shape.radius, start) + SLACK
        store(extent[WIDE], start, cosine * width + sine * height + radius)
        store(extent[TALL], start, sine * width + cosine * height + radius)
    return body.x, body.y, extent[WIDE], extent[TALL]


@kernel
def within(crowd: tuple[Array, Array, Array, Array], g: int, x: Real, y: Real, reach: Real) -> int:
    """Who may come nearer than `reach` to the point."""
    xs, ys, wide, tall = crowd
    near_x = abs(load(xs, SIMD_WIDTH * g) - x) <= load(wide, SIMD_WIDTH * g) + reach
    return int(to_bits(near_x & (abs(load(ys, SIMD_WIDTH * g) - y) <= load(tall, SIMD_WIDTH * g) + reach)))


@kernel
def across(crowd: tuple[Array, Array, Array, Array], g: int, ox: Real, oy: Real, dx: Real, dy: Real) -> int:
    """Whom the ray o + f d, 0 <= f <= 1, may enter: no line along x, y or the ray itself parts them."""
    xs, ys, wides, talls = crowd
    wide, tall = load(wides, SIMD_WIDTH * g), load(talls, SIMD_WIDTH * g)
    x, y = load(xs, SIMD_WIDTH * g) - ox, load(ys, SIMD_WIDTH * g) - oy
    in_x = (x - wide <= max(dx, ZERO)) & (x + wide >= min(dx, ZERO))
    in_y = (y - tall <= max(dy, ZERO)) & (y + tall >= min(dy, ZERO))
    return int(to_bits(in_x & in_y & (abs(x * dy - y * dx) <= wide * abs(dy) + tall * abs(dx))))
