"""Joints of the native backend: Box2D's weld, distance and rope joints in slots, solved by its own functions."""

import numpy as np
from numpy.typing import NDArray

from outlast.ecs.kernels.jit import noinline_kernel

from . import layout as at
from .batch import (
    FIRST,
    FORCE,
    HERTZ,
    JOINT_LIMITS,
    JOINTS,
    KIND,
    MOST_JOINTS,
    OTHER_X,
    OTHER_Y,
    OWN_X,
    OWN_Y,
    RATIO,
    REST,
    ROD,
    SECOND,
    WELD,
)
from .workspace import JOINT, JOINT_SLOT, LINKS, SLOT, SLOTS, SOLVER_DATA

_ZERO = np.float32(0)


@noinline_kernel
def sound(joints: NDArray[np.float32], joined: int, count: int) -> bool:
    """Return whether all numbers of joints are in bounds, none is NaN, and both bodies of each are in the batch."""
    valid = joined <= MOST_JOINTS
    for k in range(joined if valid else 0):
        for column in range(JOINTS):
            valid &= abs(joints[k, column]) <= JOINT_LIMITS[column]
        valid &= min(joints[k, FIRST], joints[k, SECOND], joints[k, HERTZ], joints[k, RATIO]) >= 0
        valid &= max(joints[k, FIRST], joints[k, SECOND]) < count and joints[k, FIRST] != joints[k, SECOND]
        valid &= joints[k, KIND] == WELD or joints[k, REST] >= 0
    return bool(valid)


@noinline_kernel
def build_joint(base: int, joints: NDArray[np.float32], k: int) -> None:
    """Make joint k in its slot, and put it first in the lists of its bodies, as b2World::CreateJoint does."""
    joint = base + JOINT + JOINT_SLOT * k
    for word in range(0, JOINT_SLOT, 8):
        at.store_i8(joint + word, 0)
    kind = int(joints[k, KIND])
    at.store_i4(joint + at.JOINT_TYPE, kind)
    at.store_u1(joint + at.JOINT_COLLIDES, np.uint8(kind != WELD))
    a, b = base + SLOTS + SLOT * int(joints[k, FIRST]), base + SLOTS + SLOT * int(joints[k, SECOND])
    at.store_i8(joint + at.JOINT_BODY_A, a)
    at.store_i8(joint + at.JOINT_BODY_B, b)
    _link(joint, joint + at.JOINT_EDGE_A, a, b)
    _link(joint, joint + at.JOINT_EDGE_B, b, a)
    spring, anchors, rest = at.WELD_SPRING, at.WELD_ANCHORS, at.WELD_ANGLE
    if kind == ROD:
        spring, anchors, rest = at.ROD_SPRING, at.ROD_ANCHORS, at.ROD_LENGTH
    elif kind != WELD:
        spring, anchors, rest = 0, at.ROPE_ANCHORS, at.ROPE_LENGTH
    if spring:
        at.store_f4(joint + spring, joints[k, HERTZ])
        at.store_f4(joint + spring + 4, joints[k, RATIO])
    at.store_f4(joint + anchors, joints[k, OWN_X])
    at.store_f4(joint + anchors + 4, joints[k, OWN_Y])
    at.store_f4(joint + anchors + 8, joints[k, OTHER_X])
    at.store_f4(joint + anchors + 12, joints[k, OTHER_Y])
    at.store_f4(joint + rest, joints[k, REST])


@noinline_kernel
def _link(joint: int, edge: int, body: int, other: int) -> None:
    at.store_i8(edge + at.LINK_OTHER, other)
    at.store_i8(edge + at.LINK_JOINT, joint)
    at.store_i8(edge + at.LINK_NEXT, at.load_i8(body + at.BODY_JOINTS))
    at.store_i8(body + at.BODY_JOINTS, edge)


@noinline_kernel
def begin_joints(workspace: int, links: int) -> None:
    """b2Joint::InitVelocityConstraints of all joints of the island."""
    data = workspace + SOLVER_DATA
    for k in range(links):
        joint = at.load_i8(workspace + LINKS + 8 * k)
        kind = at.load_i4(joint + at.JOINT_TYPE)
        if kind == WELD:
            at.begin_weld(joint, data)
        elif kind == ROD:
            at.begin_rod(joint, data)
        else:
            at.begin_rope(joint, data)


@noinline_kernel
def joint_velocities(workspace: int, links: int) -> None:
    """b2Joint::SolveVelocityConstraints of all joints of the island."""
    data = workspace + SOLVER_DATA
    for k in range(links):
        joint = at.load_i8(workspace + LINKS + 8 * k)
        kind = at.load_i4(joint + at.JOINT_TYPE)
        if kind == WELD:
            at.weld_velocities(joint, data)
        elif kind == ROD:
            at.rod_velocities(joint, data)
        else:
            at.rope_velocities(joint, data)


@noinline_kernel
def joint_positions(workspace: int, links: int) -> bool:
    """b2Joint::SolvePositionConstraints of all joints of the island: whether they hold closely enough."""
    data, settled = workspace + SOLVER_DATA, True
    for k in range(links):
        joint = at.load_i8(workspace + LINKS + 8 * k)
        kind = at.load_i4(joint + at.JOINT_TYPE)
        if kind == WELD:
            settled &= at.weld_positions(joint, data) != 0
        elif kind == ROD:
            settled &= at.rod_positions(joint, data) != 0
        else:
            settled &= at.rope_positions(joint, data) != 0
    return settled


@noinline_kernel
def measure_forces(base: int, inverse_dt: np.float32, joints: NDArray[np.float32], joined: int) -> None:
    """Note the largest force on each joint so far, as b2Joint::GetReactionForce has it after a substep."""
    for k in range(joined):
        joint = base + JOINT + JOINT_SLOT * k
        kind = int(joints[k, KIND])
        if kind == WELD:
            x = inverse_dt * at.load_f4(joint + at.WELD_IMPULSE)
            y = inverse_dt * at.load_f4(joint + at.WELD_IMPULSE + 4)
        else:
            impulse, axis = at.ROPE_IMPULSE, at.ROPE_AXIS
            if kind == ROD:
                impulse, axis = at.ROD_IMPULSE, at.ROD_AXIS
            force = inverse_dt * at.load_f4(joint + impulse)
            x, y = force * at.load_f4(joint + axis), force * at.load_f4(joint + axis + 4)
        joints[k, FORCE] = max(joints[k, FORCE], np.float32(np.sqrt(x * x + y * y)))
