"""Transfer of the marked bodies of a world into a contact batch, and of their new state back."""

from typing import Any

import numpy as np

from outlast.components.contact import ALL
from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load_flags, to_bits

from ..geometry.blocks import alive_bits, first_row
from ..geometry.bodies import all_aabbs, refresh
from ..geometry.broad_phase import clearance
from .batch import (
    ANGLE,
    ANGULAR_DAMPING,
    CORNER,
    CORNERS,
    DRIVEN,
    DYNAMIC,
    FRICTION,
    HALF_HEIGHT,
    HALF_WIDTH,
    HITS,
    INERTIA,
    JTURN,
    JX,
    JY,
    LAYER,
    LINEAR_DAMPING,
    LONGEST,
    MASS,
    MAX_TRAVEL,
    OMEGA,
    RADIUS,
    RESTITUTION,
    SENSOR,
    VX,
    VY,
    Settings,
    X,
    Y,
)

ZERO = np.float32(0)


@kernel
def marked(solid: Array, entities: Array, solids: Array, b: int) -> int:
    """Return the bodies of block `b` that go into the batch."""
    return int(alive_bits(entities, solids, b) & to_bits(load_flags(solid.may_collide, SIMD_WIDTH * b)))


@kernel
def some_marked(solid: Array, entities: Array, solids: Array) -> bool:
    """Return whether any body goes into the batch."""
    some = 0
    for b in range(solids.size):
        some |= marked(solid, entities, solids, b)
    return some != 0


@kernel
def gather(
    batch: Array, bodies: Any, push: Array, solid: Array, entities: Array, solids: Array, driven: Any, substeps: int
) -> int:
    """Write the marked bodies into `batch` in order of rows. Return their number."""
    count = 0
    refresh(bodies)
    aabbs, body, shape = all_aabbs(bodies), bodies.body, bodies.shape
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
            if driven is not None and driven[e] >= 0 and not solid.dynamic[e]:
                batch[count, DYNAMIC] = DRIVEN
            batch[count, JX], batch[count, JY] = push.x[e] / substeps, push.y[e] / substeps
            batch[count, JTURN] = push.turn[e] / substeps
            batch[count, MASS], batch[count, INERTIA], batch[count, MAX_TRAVEL] = ZERO, ZERO, ZERO
            if solid.dynamic[e]:
                batch[count, MASS], batch[count, INERTIA] = solid.mass[e], solid.inertia[e]
                batch[count, MAX_TRAVEL] = clearance(aabbs, body, shape, solid, entities, solids, LONGEST * substeps, e)
            elif batch[count, DYNAMIC] != DRIVEN:  # Box2D would move even a static body in contacts
                batch[count, VX], batch[count, VY], batch[count, OMEGA] = ZERO, ZERO, ZERO
            count += 1
    return count


@kernel
def scatter(batch: Array, body: Array, solid: Array, entities: Array, solids: Array) -> None:
    """Read the marked bodies that move back from `batch`."""
    k = 0
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            if batch[k, DYNAMIC] != ZERO:
                body.x[e], body.y[e], body.angle[e] = batch[k, X], batch[k, Y], batch[k, ANGLE]
                body.vx[e], body.vy[e], body.omega[e] = batch[k, VX], batch[k, VY], batch[k, OMEGA]
            k += 1


@kernel
def describe(
    traits: Array,
    settings: Settings,
    solid: Array,
    entities: Array,
    solids: Array,
    filters: Any,
    filtered: Any,
    materials: Any,
    made: Any,
) -> None:
    """Write the traits of the marked bodies in order of rows; filtered, made: whether rows have these components."""
    k = 0
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            traits[k, FRICTION], traits[k, RESTITUTION] = settings.friction, settings.restitution
            traits[k, LINEAR_DAMPING], traits[k, ANGULAR_DAMPING] = settings.linear_damping, settings.angular_damping
            traits[k, LAYER], traits[k, HITS], traits[k, SENSOR] = 1, ALL, 0
            if materials is not None and made[e] >= 0:
                traits[k, FRICTION] = own(materials.friction[e], settings.friction)
                traits[k, RESTITUTION] = own(materials.restitution[e], settings.restitution)
                traits[k, LINEAR_DAMPING] = own(materials.linear_damping[e], settings.linear_damping)
                traits[k, ANGULAR_DAMPING] = own(materials.angular_damping[e], settings.angular_damping)
            if filters is not None and filtered[e] >= 0:
                traits[k, LAYER], traits[k, HITS] = filters.layer[e], filters.hits[e]
                traits[k, SENSOR] = filters.sensor[e]
            k += 1


@kernel
def gather_outlines(outlines: Array, polygons: Any, solid: Array, entities: Array, solids: Array) -> Any:
    """Write the polygons among the marked bodies in order of rows. Return None in games without polygons."""
    if polygons is None:
        return None
    k = 0
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            outlines[k, CORNERS] = polygons.corners[e]
            for n in range(polygons.corners[e]):
                outlines[k, CORNER + 2 * n], outlines[k, CORNER + 2 * n + 1] = polygons.x[e, n], polygons.y[e, n]
            k += 1
    return outlines


@kernel
def own(value: Real, usual: Real) -> Real:
    """Return a body's own number, or the usual one if that is below 0. NaN is kept, and refused by Box2D's batch."""
    return usual if value < ZERO else value
