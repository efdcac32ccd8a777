"""Between the tables of a world and a scene: the marked bodies go in, their new state comes out."""

import numpy as np

from outlast.ecs import Array, kernel
from outlast.ecs.simd import SIMD_WIDTH, load_flags, to_bits

from ..inner.broad import clearance
from ..inner.sweep import enclose, present, row
from .scene import (
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
    OMEGA,
    RADIUS,
    REACH,
    VX,
    VY,
    X,
    Y,
)

ZERO = np.float32(0)


@kernel
def marked(solid: Array, entities: Array, solids: Array, g: int) -> int:
    """The bodies of group `g` that go into the scene."""
    return int(present(entities, solids, g) & to_bits(load_flags(solid.near, SIMD_WIDTH * g)))


@kernel
def stage(
    scene: Array,
    extent: Array,
    body: Array,
    shape: Array,
    push: Array,
    solid: Array,
    entities: Array,
    solids: Array,
    substeps: int,
) -> int:
    """Write the marked bodies into `scene` in order of rows; returns how many. extent: scratch of `enclose`."""
    crowd, count = enclose(extent, body, shape), 0
    for g in range(solids.size):
        left = marked(solid, entities, solids, g)
        while left:
            e = row(g, left)
            left &= left - 1
            scene[count, X], scene[count, Y], scene[count, ANGLE] = body.x[e], body.y[e], body.angle[e]
            scene[count, VX], scene[count, VY], scene[count, OMEGA] = body.vx[e], body.vy[e], body.omega[e]
            scene[count, RADIUS] = shape.radius[e]
            scene[count, HALF_WIDTH], scene[count, HALF_HEIGHT] = shape.half_width[e], shape.half_height[e]
            scene[count, DYNAMIC] = solid.dynamic[e]
            scene[count, MASS], scene[count, INERTIA] = solid.mass[e], solid.inertia[e]
            scene[count, JX], scene[count, JY] = push.x[e] / substeps, push.y[e] / substeps
            scene[count, JTURN] = push.turn[e] / substeps
            scene[count, REACH] = ZERO
            if solid.dynamic[e]:
                scene[count, REACH] = clearance(crowd, body, shape, solid, entities, solids, LONGEST * substeps, e)
            count += 1
    return count


@kernel
def unstage(scene: Array, body: Array, solid: Array, entities: Array, solids: Array) -> None:
    """Read the marked dynamic bodies back from `scene`."""
    k = 0
    for g in range(solids.size):
        left = marked(solid, entities, solids, g)
        while left:
            e = row(g, left)
            left &= left - 1
            if solid.dynamic[e]:
                body.x[e], body.y[e], body.angle[e] = scene[k, X], scene[k, Y], scene[k, ANGLE]
                body.vx[e], body.vy[e], body.omega[e] = scene[k, VX], scene[k, VY], scene[k, OMEGA]
            k += 1
