"""The broad phase of contacts: distances between bodies, and safe distances of motion."""

import numpy as np

from outlast.components.body import inverse
from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, to_bits

from .aabb import AABBs, aabbs_near_point
from .blocks import alive_bits, first_row
from .points import gap_circle_box

ZERO = np.float32(0)


@kernel
def outer_radius(shape: Array, e: int) -> Real:
    """Return the radius of the circle around body `e`, metres."""
    x, y = shape.half_width[e], shape.half_height[e]
    return max(shape.radius[e], np.float32(np.sqrt(x * x + y * y)))


@kernel
def travel(body: Array, push: Array, solid: Array, e: int, time: Real) -> Real:
    """Return an upper bound of the distance body `e` moves in `time` seconds if nothing touches it."""
    inverse_mass = inverse(solid.mass[e])
    vx = abs(body.vx[e]) + inverse_mass * abs(push.x[e])
    vy = abs(body.vy[e]) + inverse_mass * abs(push.y[e])
    return np.float32(np.sqrt(vx * vx + vy * vy)) * time


@kernel
def gap(body: Array, shape: Array, e: int, o: int) -> Real:
    """Return a lower bound of the distance between the surfaces of two bodies; `e` counts as the circle around it."""
    if shape.radius[o] == ZERO:
        return gap_circle_box(
            body.x[e],
            body.y[e],
            outer_radius(shape, e),
            body.x[o],
            body.y[o],
            body.cosine[o],
            body.sine[o],
            shape.half_width[o],
            shape.half_height[o],
        )
    x, y = body.x[e] - body.x[o], body.y[e] - body.y[o]
    return np.float32(np.sqrt(x * x + y * y)) - outer_radius(shape, e) - shape.radius[o]


@kernel
def clearance(
    aabbs: AABBs, body: Array, shape: Array, solid: Array, entities: Array, solids: Array, most: Real, e: int
) -> Real:
    """Return the distance, at most `most`, of body `e` before it could touch a body outside of the batch."""
    free, radius = most, outer_radius(shape, e)
    for b in range(solids.size):
        pending = alive_bits(entities, solids, b) & ~to_bits(load_flags(solid.may_collide, SIMD_WIDTH * b))
        if pending:
            distance = load(solid.max_travel, SIMD_WIDTH * b) + (radius + free)
            pending &= aabbs_near_point(aabbs, b, body.x[e], body.y[e], distance)
        while pending:
            o = first_row(b, pending)
            pending &= pending - 1
            free = min(free, gap(body, shape, e, o) - solid.max_travel[o])
    return max(free, ZERO)
