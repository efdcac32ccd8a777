"""Box2D at native speed: kernels that build a scene in a borrowed b2World, step it and forget it.

Each thread owns one arena. A call leaves it as it found it, so the result is a function of the scene alone.
"""

import numpy as np
from numpy.typing import NDArray

from outlast.ecs.jit import compiled, kernel

from .box2d_arena import BODY_DEF, BOX, CAPACITY, DISC, FIXTURE, SLOT, SLOTS, SOLVER_DEF, STEP, make_arena
from .box2d_impact import may_hit
from .box2d_island import solve_islands
from .box2d_layout import (
    BODY_ANGLE, BODY_FIXTURES, BODY_FIXTURE_COUNT, BODY_INVERSE_INERTIA, BODY_INVERSE_MASS, BODY_NEXT,
    BODY_OMEGA, BODY_POSITION, BODY_VELOCITY, CIRCLE_RADIUS, CONTACT_NEXT, DEF_ANGLE, DEF_ANGULAR_DAMPING,
    DEF_LINEAR_DAMPING, DEF_OMEGA, DEF_POSITION, DEF_TYPE, DEF_VELOCITY, FIXTURE_DENSITY,
    FIXTURE_FRICTION, FIXTURE_PROXY_COUNT, FIXTURE_RESTITUTION, FIXTURE_SHAPE, MANAGER_CONTACTS,
    MANAGER_CONTACT_COUNT, MOVE_COUNT, MOVING, NODE_HEIGHT, NODE_NEXT, NODE_SIZE, POLYGON_VERTICES,
    PROXY_COUNT, STATIC, STEP_DT, STEP_INVERSE_DT, STEP_POSITION, STEP_RATIO, STEP_VELOCITY, STEP_WARM,
    TREE_CAPACITY, TREE_COUNT, TREE_FREE, TREE_INSERTIONS, TREE_NODES, TREE_ROOT, WORLD_BODIES,
    WORLD_BODY_COUNT, WORLD_MANAGER, collide, construct_body, create_proxies, destroy_contact,
    find_new_contacts, load_f4, load_i4, load_i8, reset_mass, solve_impacts, store_f4, store_i4, store_i8,
    store_u1,
)  # fmt: skip
from .box2d_verify import verify
from .scene import (
    ABANDONED, ANGLE, DYNAMIC, HALF_HEIGHT, HALF_WIDTH, INVALID, JTURN, JX, JY, LIMIT, OMEGA, RADIUS, REACH,
    SMALLEST, SOLVED, VX, VY, X, Y, IncompatibleBox2D, Scene, Settings,
)  # fmt: skip

__all__ = ["CAPACITY", "available", "make_arena", "solve", "verify"]

_ZERO, _ONE = np.float32(0), np.float32(1)


def available() -> bool:
    """Whether this process can use the native bridge: kernels are compiled, the library is as expected."""
    try:
        verify()
    except IncompatibleBox2D:
        return False
    return compiled()


@kernel
def solve(arena: NDArray[np.uint8], settings: Settings, scene: Scene, count: int) -> int:
    """Step bodies 0..count-1 of `scene` together for one tick and write X..OMEGA of the dynamic ones.

    Returns SOLVED; or, with the scene untouched, ABANDONED if a body moved further than its REACH, INVALID if
    there are more than CAPACITY bodies or a number that Box2D would reject (which would end the process).
    """
    base = arena.ctypes.data
    if not _valid(scene, count):
        return INVALID
    for k in range(count):
        _build(base, settings, scene, k)
    store_i4(base + WORLD_BODY_COUNT, count)
    find_new_contacts(base + WORLD_MANAGER)
    result = SOLVED
    for substep in range(settings.substeps):
        _step(base, settings, scene, count, substep)
        result = _check_reach(base, scene, count)
        if result != SOLVED:
            break
    if result == SOLVED:
        _read(base, scene, count)
    _forget(base, count)
    return result


@kernel
def _valid(scene: Scene, count: int) -> bool:
    """Whether all numbers are in bounds (not NaN either) and no moving box has too little area for a mass."""
    if count > CAPACITY:
        return False
    valid = True
    for k in range(count):
        for column in range(REACH):
            valid &= abs(scene[k, column]) < LIMIT
        for column in range(JX, JTURN + 1):
            valid &= abs(scene[k, column]) < LIMIT
        box = scene[k, HALF_WIDTH] > SMALLEST and scene[k, HALF_HEIGHT] > SMALLEST
        valid &= scene[k, RADIUS] > SMALLEST or (scene[k, RADIUS] == 0 and box)
    return valid


@kernel
def _build(base: int, settings: Settings, scene: Scene, k: int) -> None:
    """Make body k in its slot with Box2D's own constructor, one fixture, and its proxy in the broad phase."""
    body, definition = base + SLOTS + SLOT * k, base + BODY_DEF
    store_i4(definition + DEF_TYPE, MOVING if scene[k, DYNAMIC] != 0 else STATIC)
    store_f4(definition + DEF_POSITION, scene[k, X])
    store_f4(definition + DEF_POSITION + 4, scene[k, Y])
    store_f4(definition + DEF_ANGLE, scene[k, ANGLE])
    store_f4(definition + DEF_VELOCITY, scene[k, VX])
    store_f4(definition + DEF_VELOCITY + 4, scene[k, VY])
    store_f4(definition + DEF_OMEGA, scene[k, OMEGA])
    store_f4(definition + DEF_LINEAR_DAMPING, settings.linear_damping)
    store_f4(definition + DEF_ANGULAR_DAMPING, settings.angular_damping)
    construct_body(body, definition, base)
    fixture = body + FIXTURE
    store_f4(fixture + FIXTURE_DENSITY, settings.density)
    store_f4(fixture + FIXTURE_FRICTION, settings.friction)
    store_f4(fixture + FIXTURE_RESTITUTION, settings.restitution)
    store_i4(fixture + FIXTURE_PROXY_COUNT, 0)
    store_i8(fixture + FIXTURE_SHAPE, _shape(body, scene, k))
    create_proxies(fixture, base + WORLD_MANAGER, body + BODY_POSITION)
    store_i8(body + BODY_FIXTURES, fixture)
    store_i4(body + BODY_FIXTURE_COUNT, 1)
    reset_mass(body)
    store_i8(body + BODY_NEXT, load_i8(base + WORLD_BODIES))
    store_i8(base + WORLD_BODIES, body)


@kernel
def _shape(body: int, scene: Scene, k: int) -> int:
    """Write the shape of body k; the corners go round counter-clockwise from the lower left (SetAsBox)."""
    if scene[k, RADIUS] > 0:
        store_f4(body + DISC + CIRCLE_RADIUS, scene[k, RADIUS])
        return body + DISC
    width, height = scene[k, HALF_WIDTH], scene[k, HALF_HEIGHT]
    corner = body + BOX + POLYGON_VERTICES
    store_f4(corner, -width)
    store_f4(corner + 4, -height)
    store_f4(corner + 8, width)
    store_f4(corner + 12, -height)
    store_f4(corner + 16, width)
    store_f4(corner + 20, height)
    store_f4(corner + 24, -width)
    store_f4(corner + 28, height)
    return body + BOX


@kernel
def _step(base: int, settings: Settings, scene: Scene, count: int, substep: int) -> None:
    """One substep, as b2World::Step; impulses from the substep before start the solver (ratio)."""
    for k in range(count):
        if scene[k, DYNAMIC] != 0:
            _push(base + SLOTS + SLOT * k, scene, k)
    inverse = _ONE / settings.dt
    for step in (base + STEP, base + SOLVER_DEF):
        store_f4(step + STEP_DT, settings.dt)
        store_f4(step + STEP_INVERSE_DT, inverse)
        store_f4(step + STEP_RATIO, inverse * settings.dt if substep else _ZERO)
        store_i4(step + STEP_VELOCITY, settings.velocity_iterations)
        store_i4(step + STEP_POSITION, settings.position_iterations)
        store_u1(step + STEP_WARM, 1)
    collide(base + WORLD_MANAGER)
    solve_islands(base, settings)
    if settings.continuous and may_hit(base):
        solve_impacts(base, base + STEP)


@kernel
def _push(body: int, scene: Scene, k: int) -> None:
    """b2Body::ApplyLinearImpulse at the centre and ApplyAngularImpulse; zero impulses are skipped."""
    if scene[k, JX] != 0 or scene[k, JY] != 0:
        mass = load_f4(body + BODY_INVERSE_MASS)
        store_f4(body + BODY_VELOCITY, load_f4(body + BODY_VELOCITY) + mass * scene[k, JX])
        store_f4(body + BODY_VELOCITY + 4, load_f4(body + BODY_VELOCITY + 4) + mass * scene[k, JY])
    if scene[k, JTURN] != 0:
        turn = load_f4(body + BODY_INVERSE_INERTIA) * scene[k, JTURN]
        store_f4(body + BODY_OMEGA, load_f4(body + BODY_OMEGA) + turn)


@kernel
def _check_reach(base: int, scene: Scene, count: int) -> int:
    for k in range(count):
        position = base + SLOTS + SLOT * k + BODY_POSITION
        x, y = load_f4(position) - scene[k, X], load_f4(position + 4) - scene[k, Y]
        if scene[k, DYNAMIC] != 0 and x * x + y * y > scene[k, REACH] * scene[k, REACH]:
            return ABANDONED
    return SOLVED


@kernel
def _read(base: int, scene: Scene, count: int) -> None:
    for k in range(count):
        body = base + SLOTS + SLOT * k
        if scene[k, DYNAMIC] != 0:
            scene[k, X] = load_f4(body + BODY_POSITION)
            scene[k, Y] = load_f4(body + BODY_POSITION + 4)
            scene[k, ANGLE] = load_f4(body + BODY_ANGLE)
            scene[k, VX] = load_f4(body + BODY_VELOCITY)
            scene[k, VY] = load_f4(body + BODY_VELOCITY + 4)
            scene[k, OMEGA] = load_f4(body + BODY_OMEGA)


@kernel
def _forget(base: int, count: int) -> None:
    """Make the world empty again, faster than destroying its bodies, and its tree as good as new.

    The tree hands out nodes from a free list and the order of contacts follows the node numbers: history.
    """
    manager = base + WORLD_MANAGER
    contact = load_i8(manager + MANAGER_CONTACTS)
    while contact:
        following = load_i8(contact + CONTACT_NEXT)
        destroy_contact(contact, base)
        contact = following
    store_i8(manager + MANAGER_CONTACTS, 0)
    store_i4(manager + MANAGER_CONTACT_COUNT, 0)
    store_i8(base + WORLD_BODIES, 0)
    store_i4(base + WORLD_BODY_COUNT, 0)
    store_i4(manager + PROXY_COUNT, 0)
    store_i4(manager + MOVE_COUNT, 0)
    store_i4(manager + TREE_ROOT, -1)
    store_i4(manager + TREE_COUNT, 0)
    store_i4(manager + TREE_FREE, 0)
    store_i4(manager + TREE_INSERTIONS, 0)
    node = load_i8(manager + TREE_NODES)
    for following_node in range(1, min(2 * count, load_i4(manager + TREE_CAPACITY) - 1) + 1):
        store_i4(node + NODE_NEXT, following_node)
        store_i4(node + NODE_HEIGHT, -1)
        node += NODE_SIZE
