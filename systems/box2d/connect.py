"""Joints of a contact batch: their bodies, forces and ends."""

import math
from typing import Any

import numpy as np

from outlast.ecs import Array, Real, emit, kernel
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH

from ..geometry.blocks import first_row
from .batch import FIRST, FORCE, HERTZ, KIND, OTHER_X, OTHER_Y, OWN_X, OWN_Y, RATIO, REST, ROD, ROPE, SECOND, WELD
from .transfer import marked

ZERO, TURN = np.float32(0), np.float32(2 * math.pi)


@kernel
def mark_joined(joints: Any, solid: Array, entities: Array, solids: Array, joined: Array) -> None:
    """Mark both ends of every joint, since both must be in the batch. End impossible joints.

    joints: the table Weld or Rope, or None. joined: the rows that have the component, or None.
    """
    if joints is not None:
        for e in joined:
            o = joints.other[e]
            joints.force[e] = ZERO
            if o < 0:
                continue
            known = (solids[o >> SIMD_SHIFT] >> (o & (SIMD_WIDTH - 1))) & 1
            if e == o or not (known and entities.alive[e] and entities.alive[o]):
                joints.other[e] = -1
            elif solid.dynamic[e] or solid.dynamic[o]:
                solid.may_collide[e], solid.may_collide[o] = 1, 1


@kernel
def number_marked(spots: Array, solid: Array, entities: Array, solids: Array) -> None:
    """Write into `spots[0]`, by row, the position of each marked body in the batch, and into `spots[1]` the reverse."""
    k = 0
    for b in range(solids.size):
        pending = marked(solid, entities, solids, b)
        while pending:
            e = first_row(b, pending)
            spots[0, e], spots[1, k] = k, e
            pending &= pending - 1
            k += 1


@kernel
def pulls(joints: Any, solid: Array, e: int) -> bool:
    """Return whether row `e` has a joint with a body that it can move."""
    o = joints.other[e]
    return bool(o >= 0 and (solid.dynamic[e] or solid.dynamic[o]))


@kernel
def gather_joints(
    rows: Array, body: Array, solid: Array, welds: Any, welders: Any, ropes: Any, tied: Any, spots: Array
) -> int:
    """Write the joints into `rows`, welds first. Return their number."""
    k = 0
    if welds is not None:
        for e in welders:
            if pulls(welds, solid, e):
                o = welds.other[e]
                fill(rows[k], WELD, spots[0, e], spots[0, o], welds, e)
                rows[k, OTHER_X], rows[k, OTHER_Y] = ZERO, ZERO
                rows[k, REST] = nearest_turn(welds.angle[e], body.angle[o] - body.angle[e])
                k += 1
    if ropes is not None:
        for e in tied:
            if pulls(ropes, solid, e):
                o = ropes.other[e]
                fill(rows[k], ROD if ropes.rod[e] else ROPE, spots[0, e], spots[0, o], ropes, e)
                rows[k, OTHER_X], rows[k, OTHER_Y] = ropes.other_x[e], ropes.other_y[e]
                rows[k, REST] = ropes.length[e]
                k += 1
    return k


@kernel
def fill(row: Array, kind: int, first: int, second: int, joints: Any, e: int) -> None:
    """Write the common fields of welds and ropes."""
    row[KIND], row[FIRST], row[SECOND], row[FORCE] = kind, first, second, ZERO
    row[OWN_X], row[OWN_Y] = joints.x[e], joints.y[e]
    row[HERTZ], row[RATIO] = joints.hertz[e], joints.damping[e]


@kernel
def nearest_turn(angle: Real, present: Real) -> Real:
    """Return an angle, or the angle that differs by full turns and is nearest to the present one."""
    turns = np.float32(np.rint((present - angle) / TURN))
    return angle if turns == ZERO else angle + turns * TURN


@kernel
def read_forces(rows: Array, start: int, joints: Any, broken: Any, solid: Array, joined: Any) -> int:
    """Read the forces on welds, or on ropes, back from `rows`, and end those that break. Return the next row."""
    k = start
    if joints is not None:
        for e in joined:
            if pulls(joints, solid, e):
                joints.force[e] = rows[k, FORCE]
                if joints.breaks_at[e] > ZERO and joints.force[e] > joints.breaks_at[e]:
                    if broken is not None:
                        n = emit(broken)
                        broken.solid[n], broken.other[n] = e, joints.other[e]
                        broken.force[n] = joints.force[e]
                    joints.other[e] = -1
                k += 1
    return k
