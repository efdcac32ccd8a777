"""Gather the marked bodies of a world into a contact batch, and scatter their new state back."""

import numpy as np

from outlast.ecs import Array, kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load_flags, to_bits

from ..geometry.aabb import compute_aabbs
from ..geometry.blocks import alive_bits, first_row
from ..geometry.broad_phase import clearance
from .batch import (
    ANGLE,
    DYNAMIC,
    HALF_HEIGHT,
    HALF_WIDTH,
    INERTIA,
    JTURN,
    JX,
    JY,
    LONGEST,
    MASS,
    MAX_TRAVEL,
    OMEGA,
    RADIUS,
    VX,
    VY,
    X,
    Y,
)

ZERO = np.float32(0)


@kernel
def marked(solid: Array, entities: Array, solids: Array, b: int) -> int:
    """The bodies of block `b` that go into the batch."""
    return int(alive_bits(entities, solids, b) & to_bits(load_flags(solid.may_collide, SIMD_WIDTH * b)))


@kernel
def gather(
    batch: Array,
    half_extents: Array,
    body: Array,
    shape: Array,
    push: Array,
    solid: Array,
    entities: Array,
    solids: Array,
    substeps: int,
) -> int:
    """Write the marked bodies into `batch` in order of rows; returns how many."""
    some = count = 0
    for b in range(solids.size):
        some |= marked(solid, entities, solids, b)
    if some == 0:
        return 0
    aabbs = compute_aabbs(half_extents, body, shape)
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            batch[count, X], batch[count, Y], batch[count, ANGLE] = body.x[e], body.y[e], body.angle[e]
            batch[count, VX], batch[count, VY], batch[count, OMEGA] = body.vx[e], body.vy[e], body.omega[e]
            batch[count, RADIUS] = shape.radius[e]
            batch[count, HALF_WIDTH], batch[count, HALF_HEIGHT] = shape.half_width[e], shape.half_height[e]
            batch[count, DYNAMIC] = solid.dynamic[e]
            batch[count, JX], batch[count, JY] = push.x[e] / substeps, push.y[e] / substeps
            batch[count, JTURN] = push.turn[e] / substeps
            batch[count, MASS], batch[count, INERTIA], batch[count, MAX_TRAVEL] = ZERO, ZERO, ZERO
            if solid.dynamic[e]:
                batch[count, MASS], batch[count, INERTIA] = solid.mass[e], solid.inertia[e]
                batch[count, MAX_TRAVEL] = clearance(aabbs, body, shape, solid, entities, solids, LONGEST * substeps, e)
            count += 1
    return count


@kernel
def scatter(batch: Array, body: Array, solid: Array, entities: Array, solids: Array) -> None:
    """Read the marked dynamic bodies back from `batch`."""
    k = 0
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            if solid.dynamic[e]:
                body.x[e], body.y[e], body.angle[e] = batch[k, X], batch[k, Y], batch[k, ANGLE]
                body.vx[e], body.vy[e], body.omega[e] = batch[k, VX], batch[k, VY], batch[k, OMEGA]
            k += 1
