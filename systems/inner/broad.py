"""The broad phase: how far bodies are apart, and how far they can get before they could meet."""

import numpy as np

from outlast.components.body import inverse
from outlast.ecs import Array, Real, kernel
from outlast.ecs.simd import SIMD_WIDTH, load, load_flags, to_bits

from .geometry import gap_circle_box
from .sweep import present, row, within

ZERO = np.float32(0)


@kernel
def travel(body: Array, push: Array, solid: Array, e: int, time: Real) -> Real:
    """Upper bound of the distance body `e` moves in `time` seconds if nothing touches it."""
    lightness = inverse(solid.mass[e])
    vx = abs(body.vx[e]) + lightness * abs(push.x[e])
    vy = abs(body.vy[e]) + lightness * abs(push.y[e])
    return np.float32(np.sqrt(vx * vx + vy * vy)) * time


@kernel
def gap(body: Array, shape: Array, e: int, o: int) -> Real:
    """Lower bound of the distance between the surfaces of two bodies; `e` counts as the circle around it."""
    if shape.radius[o] == ZERO:
        return gap_circle_box(
            body.x[e],
            body.y[e],
            shape.bound[e],
            body.x[o],
            body.y[o],
            body.cosine[o],
            body.sine[o],
            shape.half_width[o],
            shape.half_height[o],
        )
    x, y = body.x[e] - body.x[o], body.y[e] - body.y[o]
    return np.float32(np.sqrt(x * x + y * y)) - shape.bound[e] - shape.radius[o]


@kernel
def clearance(
    crowd: Array, body: Array, shape: Array, solid: Array, entities: Array, solids: Array, most: Real, e: int
) -> Real:
    """How far marked body `e` may be pushed before it could meet a body that is not in the scene; `most` at most."""
    free = most
    for g in range(solids.size):
        left = present(entities, solids, g) & ~to_bits(load_flags(solid.near, SIMD_WIDTH * g))
        if left:
            reach = load(solid.reach, SIMD_WIDTH * g) + (shape.bound[e] + most)
            left &= within(crowd, g, body.x[e], body.y[e], reach)
        while left:
            o = row(g, left)
            left &= left - 1
            free = min(free, gap(body, shape, e, o) - solid.reach[o])
    return max(free, ZERO)
