"""b2World::Solve without its clocks: bodies that touch are an island, and Box2D's contact solver resolves it.

Box2D reads the clock sixteen times a step, which can cost as much as the step itself, and repeats iterations
that change nothing. Both are left out here. The order of operations is Box2D's own, in float32, so results agree to
the bit.
"""

import numpy as np

from outlast.ecs.kernels.jit import noinline_kernel

from . import layout as at
from .batch import Joints, Settings, Touches, Traits
from .joints import begin_joints, joint_positions, joint_velocities
from .touches import note_island
from .workspace import (
    BEFORE,
    CONTACTS,
    GROUP,
    IMPULSES,
    JOINT,
    JOINT_SLOT,
    LINKS,
    POSITIONS,
    SOLVER,
    SOLVER_DEF,
    STACK,
    VELOCITIES,
)

_MAX_TURN = np.float32(0.5 * 3.14159265359)  # b2_maxRotation
_MAX_TURN_SQUARED = _MAX_TURN * _MAX_TURN
_ZERO, _ONE, _TWO, _FOUR = np.float32(0), np.float32(1), np.float32(2), np.float32(4)


@noinline_kernel
def solve_islands(
    workspace: int, settings: Settings, traits: Traits, joints: Joints, joined: int, touches: Touches
) -> None:
    """Advance every body that moves by one substep; new contacts are found at the end."""
    _clear_flags(workspace)
    if joints is not None:
        for k in range(joined):
            at.store_u1(workspace + JOINT + JOINT_SLOT * k + at.JOINT_FLAG, np.uint8(0))
    seed = at.load_i8(workspace + at.WORLD_BODIES)
    while seed:
        moving = at.load_i4(seed + at.BODY_TYPE) != at.STATIC
        if moving and not at.load_u2(seed + at.BODY_FLAGS) & at.IN_ISLAND:
            bodies, contacts, links = _gather(workspace, seed, traits, joints)
            _solve_island(workspace, settings, bodies, contacts, links, traits, joints, touches)
        seed = at.load_i8(seed + at.BODY_NEXT)
    body = at.load_i8(workspace + at.WORLD_BODIES)
    while body:
        if at.load_i4(body + at.BODY_TYPE) != at.STATIC:
            at.synchronize_fixtures(body)
        body = at.load_i8(body + at.BODY_NEXT)
    at.find_new_contacts(workspace + at.WORLD_MANAGER)


@noinline_kernel
def _clear_flags(workspace: int) -> None:
    body = at.load_i8(workspace + at.WORLD_BODIES)
    while body:
        at.store_u2(body + at.BODY_FLAGS, at.load_u2(body + at.BODY_FLAGS) & 0xFFFE)
        body = at.load_i8(body + at.BODY_NEXT)
    contact = at.load_i8(workspace + at.WORLD_MANAGER + at.MANAGER_CONTACTS)
    while contact:
        at.store_i4(contact + at.CONTACT_FLAGS, at.load_i4(contact + at.CONTACT_FLAGS) & ~at.IN_ISLAND)
        contact = at.load_i8(contact + at.CONTACT_NEXT)


@noinline_kernel
def _gather(workspace: int, seed: int, traits: Traits, joints: Joints) -> tuple[int, int, int]:
    """Collect what touches `seed` or is joined to it, depth first as Box2D does, but not beyond static bodies.

    Returns:
        How many bodies there are, how many contacts, and how many joints.
    """
    bodies, contacts, links, waiting = 0, 0, 0, 1
    at.store_i8(workspace + STACK, seed)
    at.store_u2(seed + at.BODY_FLAGS, at.load_u2(seed + at.BODY_FLAGS) | at.IN_ISLAND)
    while waiting:
        waiting -= 1
        body = at.load_i8(workspace + STACK + 8 * waiting)
        at.store_i4(body + at.BODY_INDEX, bodies)
        at.store_i8(workspace + GROUP + 8 * bodies, body)
        bodies += 1
        if at.load_i4(body + at.BODY_TYPE) == at.STATIC:
            continue
        edge = at.load_i8(body + at.BODY_EDGES)
        while edge:
            contact = at.load_i8(edge + at.EDGE_CONTACT)
            flags = at.load_i4(contact + at.CONTACT_FLAGS)
            if traits is not None and _is_sensor(contact):
                flags = 0
            if flags & (at.SOLID | at.IN_ISLAND) == at.SOLID:
                at.store_i4(contact + at.CONTACT_FLAGS, flags | at.IN_ISLAND)
                at.store_i8(workspace + CONTACTS + 8 * contacts, contact)
                contacts += 1
                other = at.load_i8(edge + at.EDGE_OTHER)
                if not at.load_u2(other + at.BODY_FLAGS) & at.IN_ISLAND:
                    at.store_u2(other + at.BODY_FLAGS, at.load_u2(other + at.BODY_FLAGS) | at.IN_ISLAND)
                    at.store_i8(workspace + STACK + 8 * waiting, other)
                    waiting += 1
            edge = at.load_i8(edge + at.EDGE_NEXT)
        if joints is not None:
            edge = at.load_i8(body + at.BODY_JOINTS)
            while edge:
                joint, other = at.load_i8(edge + at.LINK_JOINT), at.load_i8(edge + at.LINK_OTHER)
                if not at.load_u1(joint + at.JOINT_FLAG):
                    at.store_u1(joint + at.JOINT_FLAG, np.uint8(1))
                    at.store_i8(workspace + LINKS + 8 * links, joint)
                    links += 1
                    if not at.load_u2(other + at.BODY_FLAGS) & at.IN_ISLAND:
                        at.store_u2(other + at.BODY_FLAGS, at.load_u2(other + at.BODY_FLAGS) | at.IN_ISLAND)
                        at.store_i8(workspace + STACK + 8 * waiting, other)
                        waiting += 1
                edge = at.load_i8(edge + at.LINK_NEXT)
    return bodies, contacts, links


@noinline_kernel
def _is_sensor(contact: int) -> int:
    """Return whether one of the two that touch pushes nothing."""
    a, b = at.load_i8(contact + at.CONTACT_FIXTURE_A), at.load_i8(contact + at.CONTACT_FIXTURE_B)
    return int(at.load_u1(a + at.FIXTURE_SENSOR) | at.load_u1(b + at.FIXTURE_SENSOR))


@noinline_kernel
def _damping(dt: np.float32, rate: np.float32) -> np.float32:
    """Return the share of its speed that a body keeps in a substep."""
    return max(_ZERO, min(_ONE - dt * rate, _ONE))


@noinline_kernel
def _solve_island(
    workspace: int,
    settings: Settings,
    bodies: int,
    contacts: int,
    links: int,
    traits: Traits,
    joints: Joints,
    touches: Touches,
) -> None:
    linear = _damping(settings.dt, settings.linear_damping)
    angular = _damping(settings.dt, settings.angular_damping)
    for k in range(bodies):
        body = at.load_i8(workspace + GROUP + 8 * k)
        if traits is not None:
            linear = _damping(settings.dt, at.load_f4(body + at.BODY_LINEAR_DAMPING))
            angular = _damping(settings.dt, at.load_f4(body + at.BODY_ANGULAR_DAMPING))
        _load(body, workspace + POSITIONS + 12 * k, workspace + VELOCITIES + 12 * k, linear, angular)
    solver = workspace + SOLVER
    if contacts:
        at.store_i4(workspace + SOLVER_DEF + at.SOLVER_COUNT, contacts)
        at.construct_solver(solver, workspace + SOLVER_DEF)
        at.initialize_velocities(solver)
        at.warm_start(solver)
    if joints is not None and links > 0:
        _iterate_joined(workspace, settings.velocity_iterations, contacts, links)
    elif contacts:
        _iterate(workspace, settings.velocity_iterations, bodies, contacts)
    if contacts:
        at.store_impulses(solver)
    for k in range(bodies):
        _move(workspace + POSITIONS + 12 * k, workspace + VELOCITIES + 12 * k, settings.dt)
    if joints is not None and links > 0:
        for _ in range(settings.position_iterations):
            settled = contacts == 0 or at.solve_positions(solver) != 0
            if joint_positions(workspace, links) and settled:
                break
    elif contacts:
        for _ in range(settings.position_iterations):
            if at.solve_positions(solver):
                break
    for k in range(bodies):
        body = at.load_i8(workspace + GROUP + 8 * k)
        _store(body, workspace + POSITIONS + 12 * k, workspace + VELOCITIES + 12 * k)
        if at.load_i4(body + at.BODY_TYPE) == at.STATIC:  # it may belong to other islands too
            at.store_u2(body + at.BODY_FLAGS, at.load_u2(body + at.BODY_FLAGS) & 0xFFFE)
    if contacts:
        if touches is not None:
            note_island(workspace, contacts)
        at.destroy_solver(solver)


@noinline_kernel
def _iterate_joined(workspace: int, iterations: int, contacts: int, links: int) -> None:
    """Solve velocities of joints, then of contacts, again and again."""
    begin_joints(workspace, links)
    for _ in range(iterations):
        joint_velocities(workspace, links)
        if contacts:
            at.solve_velocities(workspace + SOLVER)


@noinline_kernel
def _iterate(workspace: int, iterations: int, bodies: int, contacts: int) -> None:
    """Solve velocities until an iteration changes no bit: the ones after it would not either."""
    constraints = at.load_i8(workspace + SOLVER + at.SOLVER_CONSTRAINTS)
    _changed(workspace, constraints, bodies, contacts)
    for _ in range(iterations):
        at.solve_velocities(workspace + SOLVER)
        if not _changed(workspace, constraints, bodies, contacts):
            break


@noinline_kernel
def _changed(workspace: int, constraints: int, bodies: int, contacts: int) -> bool:
    """Return whether any velocity or impulse differs from what the last call saw, and remember them."""
    changed = np.int64(0)
    now, before = workspace + VELOCITIES, workspace + BEFORE
    for k in range(3 * bodies):
        value = at.load_i4(now + 4 * k)
        changed |= value ^ at.load_i4(before + 4 * k)
        at.store_i4(before + 4 * k, value)
    before = workspace + IMPULSES
    for _ in range(contacts):
        a = at.load_i8(constraints + at.IMPULSES_0)
        b = at.load_i8(constraints + at.IMPULSES_1)
        changed |= (a ^ at.load_i8(before)) | (b ^ at.load_i8(before + 8))
        at.store_i8(before, a)
        at.store_i8(before + 8, b)
        constraints += at.CONSTRAINT_SIZE
        before += 16
    return bool(changed != 0)


@noinline_kernel
def _load(body: int, position: int, velocity: int, linear: np.float32, angular: np.float32) -> None:
    """Copy a body into the solver's tables, damped, and remember where it starts."""
    x, y = at.load_f4(body + at.BODY_CENTER), at.load_f4(body + at.BODY_CENTER + 4)
    u, v = at.load_f4(body + at.BODY_VELOCITY), at.load_f4(body + at.BODY_VELOCITY + 4)
    angle, omega = at.load_f4(body + at.BODY_ANGLE), at.load_f4(body + at.BODY_OMEGA)
    at.store_f4(body + at.BODY_CENTER0, x)
    at.store_f4(body + at.BODY_CENTER0 + 4, y)
    at.store_f4(body + at.BODY_ANGLE0, angle)
    if at.load_i4(body + at.BODY_TYPE) == at.MOVING:
        # + 0 is the force that nobody applies: it turns -0 into +0, as in Box2D
        u, v, omega = (u + _ZERO) * linear, (v + _ZERO) * linear, (omega + _ZERO) * angular
    at.store_f4(position, x)
    at.store_f4(position + 4, y)
    at.store_f4(position + 8, angle)
    at.store_f4(velocity, u)
    at.store_f4(velocity + 4, v)
    at.store_f4(velocity + 8, omega)


@noinline_kernel
def _move(position: int, velocity: int, dt: np.float32) -> None:
    """Integrate a position; at most 2 m and a quarter turn, Box2D's limits for one substep."""
    u, v, omega = at.load_f4(velocity), at.load_f4(velocity + 4), at.load_f4(velocity + 8)
    dx, dy, turn = dt * u, dt * v, dt * omega
    if dx * dx + dy * dy > _FOUR:
        ratio = _TWO / np.sqrt(dx * dx + dy * dy)
        u *= ratio
        v *= ratio
    if turn * turn > _MAX_TURN_SQUARED:
        omega *= _MAX_TURN / abs(turn)
    at.store_f4(position, at.load_f4(position) + dt * u)
    at.store_f4(position + 4, at.load_f4(position + 4) + dt * v)
    at.store_f4(position + 8, at.load_f4(position + 8) + dt * omega)
    at.store_f4(velocity, u)
    at.store_f4(velocity + 4, v)
    at.store_f4(velocity + 8, omega)


@noinline_kernel
def _store(body: int, position: int, velocity: int) -> None:
    """Write a solved body back and turn its frame (b2Body::SynchronizeTransform)."""
    at.store_i8(body + at.BODY_CENTER, at.load_i8(position))
    at.store_f4(body + at.BODY_ANGLE, at.load_f4(position + 8))
    at.store_i8(body + at.BODY_VELOCITY, at.load_i8(velocity))
    at.store_f4(body + at.BODY_OMEGA, at.load_f4(velocity + 8))
    at.sincos(at.load_f4(position + 8), body + at.BODY_SIN, body + at.BODY_COS)
    s, c = at.load_f4(body + at.BODY_SIN), at.load_f4(body + at.BODY_COS)
    x, y = at.load_f4(body + at.BODY_LOCAL), at.load_f4(body + at.BODY_LOCAL + 4)
    at.store_f4(body + at.BODY_POSITION, at.load_f4(position) - (c * x - s * y))
    at.store_f4(body + at.BODY_POSITION + 4, at.load_f4(position + 4) - (s * x + c * y))
