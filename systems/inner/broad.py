"""The broad phase: how far bodies are apart, and how far they can get before they could meet."""

import numpy as np

from outlast.ecs import Array, Real, kernel

from .geometry import gap_circle_box

ANYWHERE = np.float32(1e9)  # metres: no limit to how far a body may be pushed
ZERO = np.float32(0)


@kernel
def travel(body: Array, push: Array, e: int, time: Real) -> Real:
    """Upper bound of the distance body `e` moves in `time` seconds if nothing touches it."""
    vx = abs(body.vx[e]) + push.inverse_mass[e] * abs(push.x[e])
    vy = abs(body.vy[e]) + push.inverse_mass[e] * abs(push.y[e])
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
def clearance(body: Array, shape: Array, solid: Array, entities: Array, solids: Array, e: int) -> Real:
    """How far marked body `e` may be pushed before it could meet a body that is not in the scene."""
    free = ANYWHERE
    for o in solids:
        if entities.alive[o] and not solid.near[o]:
            free = min(free, gap(body, shape, e, o) - solid.reach[o])
    return max(free, ZERO)
