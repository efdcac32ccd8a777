"""b2World::Solve without its clocks: bodies that touch are an island, and Box2D's contact solver resolves it.

Box2D reads the clock sixteen times a step, which can cost as much as the step itself, and repeats iterations
that change nothing. Both are left out here; the order of operations is its own, in float32: the bits agree.
"""

import numpy as np

from outlast.ecs.jit import kernel

from .box2d_arena import BEFORE, CONTACTS, GROUP, IMPULSES, POSITIONS, SOLVER, SOLVER_DEF, STACK, VELOCITIES
from .box2d_layout import (
    BODY_ANGLE, BODY_ANGLE0, BODY_CENTER, BODY_CENTER0, BODY_COS, BODY_EDGES, BODY_FLAGS, BODY_INDEX,
    BODY_LOCAL, BODY_NEXT, BODY_OMEGA, BODY_POSITION, BODY_SIN, BODY_TYPE, BODY_VELOCITY, CONSTRAINT_SIZE,
    CONTACT_FLAGS, CONTACT_NEXT, EDGE_CONTACT, EDGE_NEXT, EDGE_OTHER, IMPULSES_0, IMPULSES_1, IN_ISLAND,
    MANAGER_CONTACTS, MOVING, SOLID, SOLVER_CONSTRAINTS, SOLVER_COUNT, STATIC, WORLD_BODIES,
    WORLD_MANAGER, construct_solver, destroy_solver, find_new_contacts, initialize_velocities, load_f4,
    load_i4, load_i8, load_u2, sincos, solve_positions, solve_velocities, store_f4, store_i4, store_i8,
    store_impulses, store_u2, synchronize_fixtures, warm_start,
)  # fmt: skip
from .scene import Settings

_MAX_TURN = np.float32(0.5 * 3.14159265359)  # b2_maxRotation
_MAX_TURN_SQUARED = _MAX_TURN * _MAX_TURN
_ZERO, _ONE, _TWO, _FOUR = np.float32(0), np.float32(1), np.float32(2), np.float32(4)


@kernel
def solve_islands(arena: int, settings: Settings) -> None:
    """Advance every dynamic body by one substep; new contacts are found at the end."""
    manager = arena + WORLD_MANAGER
    _clear_flags(arena)
    seed = load_i8(arena + WORLD_BODIES)
    while seed:
        if load_i4(seed + BODY_TYPE) == MOVING and not load_u2(seed + BODY_FLAGS) & IN_ISLAND:
            bodies, contacts = _gather(arena, seed)
            _solve_island(arena, settings, bodies, contacts)
        seed = load_i8(seed + BODY_NEXT)
    body = load_i8(arena + WORLD_BODIES)
    while body:
        if load_i4(body + BODY_TYPE) == MOVING:
            synchronize_fixtures(body)
        body = load_i8(body + BODY_NEXT)
    find_new_contacts(manager)


@kernel
def _clear_flags(arena: int) -> None:
    body = load_i8(arena + WORLD_BODIES)
    while body:
        store_u2(body + BODY_FLAGS, load_u2(body + BODY_FLAGS) & 0xFFFE)
        body = load_i8(body + BODY_NEXT)
    contact = load_i8(arena + WORLD_MANAGER + MANAGER_CONTACTS)
    while contact:
        store_i4(contact + CONTACT_FLAGS, load_i4(contact + CONTACT_FLAGS) & ~IN_ISLAND)
        contact = load_i8(contact + CONTACT_NEXT)


@kernel
def _gather(arena: int, seed: int) -> tuple[int, int]:
    """Collect what touches `seed`, depth first as Box2D does; a static body ends the search."""
    bodies, contacts, waiting = 0, 0, 1
    store_i8(arena + STACK, seed)
    store_u2(seed + BODY_FLAGS, load_u2(seed + BODY_FLAGS) | IN_ISLAND)
    while waiting:
        waiting -= 1
        body = load_i8(arena + STACK + 8 * waiting)
        store_i4(body + BODY_INDEX, bodies)
        store_i8(arena + GROUP + 8 * bodies, body)
        bodies += 1
        if load_i4(body + BODY_TYPE) == STATIC:
            continue
        edge = load_i8(body + BODY_EDGES)
        while edge:
            contact = load_i8(edge + EDGE_CONTACT)
            flags = load_i4(contact + CONTACT_FLAGS)
            if flags & (SOLID | IN_ISLAND) == SOLID:
                store_i4(contact + CONTACT_FLAGS, flags | IN_ISLAND)
                store_i8(arena + CONTACTS + 8 * contacts, contact)
                contacts += 1
                other = load_i8(edge + EDGE_OTHER)
                if not load_u2(other + BODY_FLAGS) & IN_ISLAND:
                    store_u2(other + BODY_FLAGS, load_u2(other + BODY_FLAGS) | IN_ISLAND)
                    store_i8(arena + STACK + 8 * waiting, other)
                    waiting += 1
            edge = load_i8(edge + EDGE_NEXT)
    return bodies, contacts


@kernel
def _solve_island(arena: int, settings: Settings, bodies: int, contacts: int) -> None:
    linear = max(_ZERO, min(_ONE - settings.dt * settings.linear_damping, _ONE))
    angular = max(_ZERO, min(_ONE - settings.dt * settings.angular_damping, _ONE))
    for k in range(bodies):
        body = load_i8(arena + GROUP + 8 * k)
        _load(body, arena + POSITIONS + 12 * k, arena + VELOCITIES + 12 * k, linear, angular)
    solver = arena + SOLVER
    if contacts:
        store_i4(arena + SOLVER_DEF + SOLVER_COUNT, contacts)
        construct_solver(solver, arena + SOLVER_DEF)
        initialize_velocities(solver)
        warm_start(solver)
        _iterate(arena, settings.velocity_iterations, bodies, contacts)
        store_impulses(solver)
    for k in range(bodies):
        _move(arena + POSITIONS + 12 * k, arena + VELOCITIES + 12 * k, settings.dt)
    if contacts:
        for _ in range(settings.position_iterations):
            if solve_positions(solver):
                break
        destroy_solver(solver)
    for k in range(bodies):
        body = load_i8(arena + GROUP + 8 * k)
        _store(body, arena + POSITIONS + 12 * k, arena + VELOCITIES + 12 * k)
        if load_i4(body + BODY_TYPE) == STATIC:  # it may belong to other islands too
            store_u2(body + BODY_FLAGS, load_u2(body + BODY_FLAGS) & 0xFFFE)


@kernel
def _iterate(arena: int, iterations: int, bodies: int, contacts: int) -> None:
    """Solve velocities until an iteration changes no bit: the ones after it would not either."""
    constraints = load_i8(arena + SOLVER + SOLVER_CONSTRAINTS)
    _changed(arena, constraints, bodies, contacts)
    for _ in range(iterations):
        solve_velocities(arena + SOLVER)
        if not _changed(arena, constraints, bodies, contacts):
            break


@kernel
def _changed(arena: int, constraints: int, bodies: int, contacts: int) -> bool:
    """Whether any velocity or impulse differs from what the last call saw, and remember them."""
    changed = np.int64(0)
    now, before = arena + VELOCITIES, arena + BEFORE
    for k in range(3 * bodies):
        value = load_i4(now + 4 * k)
        changed |= value ^ load_i4(before + 4 * k)
        store_i4(before + 4 * k, value)
    before = arena + IMPULSES
    for k in range(contacts):
        a = load_i8(constraints + IMPULSES_0)
        b = load_i8(constraints + IMPULSES_1)
        changed |= (a ^ load_i8(before)) | (b ^ load_i8(before + 8))
        store_i8(before, a)
        store_i8(before + 8, b)
        constraints += CONSTRAINT_SIZE
        before += 16
    return changed != 0


@kernel
def _load(body: int, position: int, velocity: int, linear: np.float32, angular: np.float32) -> None:
    """Copy a body into the solver's tables, damped, and remember where it starts."""
    x, y, angle = load_f4(body + BODY_CENTER), load_f4(body + BODY_CENTER + 4), load_f4(body + BODY_ANGLE)
    u, v, omega = load_f4(body + BODY_VELOCITY), load_f4(body + BODY_VELOCITY + 4), load_f4(body + BODY_OMEGA)
    store_f4(body + BODY_CENTER0, x)
    store_f4(body + BODY_CENTER0 + 4, y)
    store_f4(body + BODY_ANGLE0, angle)
    if load_i4(body + BODY_TYPE) == MOVING:
        # + 0 is the force that nobody applies: it turns -0 into +0, as in Box2D
        u, v, omega = (u + _ZERO) * linear, (v + _ZERO) * linear, (omega + _ZERO) * angular
    store_f4(position, x)
    store_f4(position + 4, y)
    store_f4(position + 8, angle)
    store_f4(velocity, u)
    store_f4(velocity + 4, v)
    store_f4(velocity + 8, omega)


@kernel
def _move(position: int, velocity: int, dt: np.float32) -> None:
    """Integrate a position; at most 2 m and a quarter turn, Box2D's limits for one substep."""
    u, v, omega = load_f4(velocity), load_f4(velocity + 4), load_f4(velocity + 8)
    dx, dy, turn = dt * u, dt * v, dt * omega
    if dx * dx + dy * dy > _FOUR:
        ratio = _TWO / np.sqrt(dx * dx + dy * dy)
        u *= ratio
        v *= ratio
    if turn * turn > _MAX_TURN_SQUARED:
        omega *= _MAX_TURN / abs(turn)
    store_f4(position, load_f4(position) + dt * u)
    store_f4(position + 4, load_f4(position + 4) + dt * v)
    store_f4(position + 8, load_f4(position + 8) + dt * omega)
    store_f4(velocity, u)
    store_f4(velocity + 4, v)
    store_f4(velocity + 8, omega)


@kernel
def _store(body: int, position: int, velocity: int) -> None:
    """Write a solved body back and turn its frame (b2Body::SynchronizeTransform)."""
    store_i8(body + BODY_CENTER, load_i8(position))
    store_f4(body + BODY_ANGLE, load_f4(position + 8))
    store_i8(body + BODY_VELOCITY, load_i8(velocity))
    store_f4(body + BODY_OMEGA, load_f4(velocity + 8))
    sincos(load_f4(position + 8), body + BODY_SIN, body + BODY_COS)
    s, c = load_f4(body + BODY_SIN), load_f4(body + BODY_COS)
    x, y = load_f4(body + BODY_LOCAL), load_f4(body + BODY_LOCAL + 4)
    store_f4(body + BODY_POSITION, load_f4(position) - (c * x - s * y))
    store_f4(body + BODY_POSITION + 4, load_f4(position + 4) - (s * x + c * y))
