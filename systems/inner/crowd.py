"""The crowd: everybody present in a world, packed so that most of them can be ruled out many at a time.

Rays and contacts ask one body against all others, and nearly all answers are no. The living bodies' circles are copied
into contiguous rows of a scratch array, plain loops without branches over those mark the few that are left (LLVM turns
them into vector instructions), and only those get the exact test.
"""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel

X, Y, BOUND, MARK = 0, 1, 2, 3  # rows of the array: centre and radius of the circle, 1 if not ruled out
ROW, LIST = 4, 5  # the entity's row (float32 holds it exactly below 2**24), and a list of members that are left
LINES = 6

ROUNDING = np.float32(1.001)  # slack for what float32 loses, so that nobody is ruled out who is hit
ZERO = np.float32(0)


def make_crowd(dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Scratch for the crowd of one world: float32 (LINES, rows)."""
    return np.zeros((LINES, dims["rows"]), np.float32)


@kernel
def gather(crowd: Array, body: Array, shape: Array, entities: Array, rows: Array) -> int:
    """Copy the living among `rows`; returns how many."""
    count = 0
    for e in rows:
        crowd[X, count], crowd[Y, count] = body.x[e], body.y[e]
        crowd[BOUND, count], crowd[ROW, count] = shape.bound[e], e
        count += entities.alive[e]
    return count


@kernel
def marked(crowd: Array, count: int) -> int:
    """List the marked members; returns how many. `member` reads the list."""
    left = 0
    for k in range(count):
        crowd[LIST, left] = crowd[ROW, k]
        left += crowd[MARK, k] > ZERO
    return left


@kernel
def member(crowd: Array, k: int) -> int:
    """Row of the entity that is number `k` of the list."""
    return int(crowd[LIST, k])


@kernel
def beside_ray(crowd: Array, count: int, ox: Real, oy: Real, dx: Real, dy: Real) -> int:
    """List whose circles a ray may enter: not far beside it, behind it or beyond its end."""
    square = dx * dx + dy * dy
    for k in range(count):
        x, y = crowd[X, k] - ox, crowd[Y, k] - oy
        around = crowd[BOUND, k] * crowd[BOUND, k] * ROUNDING
        across, along = x * dy - y * dx, x * dx + y * dy
        behind = (along < ZERO) & (x * x + y * y > around)
        ex, ey = x - dx, y - dy
        beyond = (along > square) & (ex * ex + ey * ey > around)
        aside = across * across > around * square
        crowd[MARK, k] = 0 if behind | beyond | aside else 1
    return marked(crowd, count)


@kernel
def within(crowd: Array, count: int, x: Real, y: Real, reach: Real) -> int:
    """List whose circles come nearer than `reach` to the point."""
    for k in range(count):
        far_x, far_y, near = crowd[X, k] - x, crowd[Y, k] - y, crowd[BOUND, k] + reach
        crowd[MARK, k] = 1 if far_x * far_x + far_y * far_y <= near * near else 0
    return marked(crowd, count)
