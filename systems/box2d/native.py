"""Box2D at native speed: kernels that build a batch in a workspace with an empty b2World, step it and reset the world.

Each thread owns one workspace. A call restores it, so the result is a function of the batch alone.
"""

import numpy as np
from numpy.typing import NDArray

from outlast.ecs.kernels.jit import compiled, noinline_kernel

from . import layout as at
from .batch import (
    ABANDONED,
    ANGLE,
    ANGULAR_DAMPING,
    CAPACITY,
    COLUMNS,
    CORNERS,
    DRIVEN,
    DYNAMIC,
    FORCE,
    FRICTION,
    HALF_HEIGHT,
    HALF_WIDTH,
    HITS,
    INERTIA,
    INVALID,
    JTURN,
    JX,
    JY,
    LAYER,
    LIMITS,
    LINEAR_DAMPING,
    MASS,
    MAX_TRAVEL,
    MOVED,
    OMEGA,
    RADIUS,
    RESTITUTION,
    SENSOR,
    SMALLEST,
    SOLVED,
    TRAIT_LIMITS,
    TRAITS,
    VX,
    VY,
    ContactBatch,
    IncompatibleBox2D,
    Joints,
    Outlines,
    Settings,
    Touches,
    Traits,
    X,
    Y,
)
from .impact import may_hit
from .island import solve_islands
from .joints import build_joint, measure_forces, sound
from .outline import restore_box, whole, write_polygon
from .touches import forget, listen, note_sensors, read_touches, watch
from .verify import verify
from .workspace import BODY_DEF, BOX, DISC, FILTER, FIXTURE, SLOT, SLOTS, SOLVER_DATA, SOLVER_DEF, STEP, make_workspace

__all__ = ["CAPACITY", "available", "listen", "make_workspace", "solve", "verify"]

_ZERO, _ONE = np.float32(0), np.float32(1)


def available() -> bool:
    """Return whether this process can use the native backend: kernels are compiled, the layout of the library fits."""
    try:
        verify()
    except IncompatibleBox2D:
        return False
    return compiled()


@noinline_kernel
def solve(
    workspace: NDArray[np.uint8],
    settings: Settings,
    batch: ContactBatch,
    count: int,
    traits: Traits = None,
    joints: Joints = None,
    joined: int = 0,
    touches: Touches = None,
    outlines: Outlines = None,
) -> int:
    """Step bodies 0..count-1 of `batch` together for one tick and write X..OMEGA of those that are not static.

    traits: properties of bodies, see `batch`; None: all have the numbers of `settings`, and touch each other.
    joints: joints of bodies, see `batch`, `joined` of them; FORCE of each is written.
    touches: None, or an array for touches, which is written.
    outlines: polygons of bodies, see `batch`; None: no polygons.

    Returns SOLVED; or, with the batch untouched, ABANDONED if a body moved further than its MAX_TRAVEL, INVALID for
    more than CAPACITY bodies or a number that Box2D would reject (which ends the process).
    """
    base = workspace.ctypes.data
    if not _valid(batch, count):
        return INVALID
    filtering = base + at.WORLD_MANAGER + at.MANAGER_FILTER
    if traits is not None and not _fair(traits, count):
        return INVALID
    if joints is not None and not sound(joints, joined, count):
        return INVALID
    if outlines is not None and not whole(outlines, count):
        return INVALID
    if traits is not None:
        at.store_i8(filtering, at.load_i8(base + FILTER))
    for k in range(count):
        _build(base, settings, batch, k, traits, outlines)
    if joints is not None:
        for k in range(joined):
            joints[k, FORCE] = _ZERO
            build_joint(base, joints, k)
    at.store_i4(base + at.WORLD_BODY_COUNT, count)
    at.find_new_contacts(base + at.WORLD_MANAGER)
    result = SOLVED
    if touches is not None:
        watch(base, True)
    for substep in range(settings.substeps):
        _step(base, settings, batch, count, substep, traits, joints, joined, touches, outlines)
        result = _check_travel(base, batch, count)
        if result != SOLVED:
            break
    if result == SOLVED:
        _read(base, batch, count)
        if touches is not None:
            read_touches(base, touches)
    if touches is not None:
        forget(base)
        watch(base, False)
    _reset(base, count)
    if traits is not None:
        at.store_i8(filtering, 0)
        for k in range(count):
            at.store_u1(base + SLOTS + SLOT * k + FIXTURE + at.FIXTURE_SENSOR, np.uint8(0))
    if outlines is not None:
        for k in range(count):
            if outlines[k, CORNERS] > 0:
                restore_box(base + SLOTS + SLOT * k + BOX)
    return result


@noinline_kernel
def _valid(batch: ContactBatch, count: int) -> bool:
    """Return whether all numbers are in bounds, none is NaN, no body is too small, and moving bodies have a mass."""
    if count > CAPACITY:
        return False
    valid = True
    for k in range(count):
        for column in range(COLUMNS):
            valid &= abs(batch[k, column]) <= LIMITS[column]
        box = batch[k, HALF_WIDTH] > SMALLEST and batch[k, HALF_HEIGHT] > SMALLEST
        valid &= batch[k, RADIUS] > SMALLEST or (batch[k, RADIUS] == 0 and box)
        valid &= batch[k, DYNAMIC] != MOVED or (batch[k, MASS] > 0 and batch[k, INERTIA] > 0)
    return valid


@noinline_kernel
def _fair(traits: NDArray[np.float32], count: int) -> bool:
    """Return whether all traits are in bounds, and none is NaN."""
    valid = True
    for k in range(count):
        for column in range(TRAITS):
            valid &= traits[k, column] >= 0 and traits[k, column] <= TRAIT_LIMITS[column]
    return valid


@noinline_kernel
def _build(base: int, settings: Settings, batch: ContactBatch, k: int, traits: Traits, outlines: Outlines) -> None:
    """Create body k in its slot with Box2D's own constructor, one fixture, and its proxy in the broad phase."""
    body, definition = base + SLOTS + SLOT * k, base + BODY_DEF
    kind = at.MOVING if batch[k, DYNAMIC] == MOVED else at.KINEMATIC if batch[k, DYNAMIC] == DRIVEN else at.STATIC
    at.store_i4(definition + at.DEF_TYPE, kind)
    at.store_f4(definition + at.DEF_POSITION, batch[k, X])
    at.store_f4(definition + at.DEF_POSITION + 4, batch[k, Y])
    at.store_f4(definition + at.DEF_ANGLE, batch[k, ANGLE])
    at.store_f4(definition + at.DEF_VELOCITY, batch[k, VX])
    at.store_f4(definition + at.DEF_VELOCITY + 4, batch[k, VY])
    at.store_f4(definition + at.DEF_OMEGA, batch[k, OMEGA])
    fixture = body + FIXTURE
    if traits is None:
        at.store_f4(definition + at.DEF_LINEAR_DAMPING, settings.linear_damping)
        at.store_f4(definition + at.DEF_ANGULAR_DAMPING, settings.angular_damping)
        at.store_f4(fixture + at.FIXTURE_FRICTION, settings.friction)
        at.store_f4(fixture + at.FIXTURE_RESTITUTION, settings.restitution)
    else:
        at.store_f4(definition + at.DEF_LINEAR_DAMPING, traits[k, LINEAR_DAMPING])
        at.store_f4(definition + at.DEF_ANGULAR_DAMPING, traits[k, ANGULAR_DAMPING])
        at.store_f4(fixture + at.FIXTURE_FRICTION, traits[k, FRICTION])
        at.store_f4(fixture + at.FIXTURE_RESTITUTION, traits[k, RESTITUTION])
        at.store_u2(fixture + at.FIXTURE_LAYER, np.uint16(traits[k, LAYER]))
        at.store_u2(fixture + at.FIXTURE_HITS, np.uint16(traits[k, HITS]))
        at.store_u1(fixture + at.FIXTURE_SENSOR, np.uint8(traits[k, SENSOR]))
    at.construct_body(body, definition, base)
    at.store_i4(fixture + at.FIXTURE_PROXY_COUNT, 0)
    at.store_i8(fixture + at.FIXTURE_SHAPE, _shape(body, batch, k, outlines))
    at.create_proxies(fixture, base + at.WORLD_MANAGER, body + at.BODY_POSITION)
    at.store_i8(body + at.BODY_FIXTURES, fixture)
    at.store_i4(body + at.BODY_FIXTURE_COUNT, 1)
    at.reset_mass(body)
    if batch[k, DYNAMIC] == MOVED:
        at.store_f4(body + at.BODY_INVERSE_MASS, _ONE / batch[k, MASS])
        at.store_f4(body + at.BODY_INVERSE_INERTIA, _ONE / batch[k, INERTIA])
    at.store_i8(body + at.BODY_NEXT, at.load_i8(base + at.WORLD_BODIES))
    at.store_i8(base + at.WORLD_BODIES, body)


@noinline_kernel
def _shape(body: int, batch: ContactBatch, k: int, outlines: Outlines) -> int:
    """Write the shape of body k; the corners go round counter-clockwise from the lower left (SetAsBox)."""
    if batch[k, RADIUS] > 0:
        at.store_f4(body + DISC + at.CIRCLE_RADIUS, batch[k, RADIUS])
        return body + DISC
    if outlines is not None and outlines[k, CORNERS] > 0:
        write_polygon(body + BOX, outlines[k])
        return body + BOX
    width, height = batch[k, HALF_WIDTH], batch[k, HALF_HEIGHT]
    corner = body + BOX + at.POLYGON_VERTICES
    at.store_f4(corner, -width)
    at.store_f4(corner + 4, -height)
    at.store_f4(corner + 8, width)
    at.store_f4(corner + 12, -height)
    at.store_f4(corner + 16, width)
    at.store_f4(corner + 20, height)
    at.store_f4(corner + 24, -width)
    at.store_f4(corner + 28, height)
    return body + BOX


@noinline_kernel
def _step(
    base: int,
    settings: Settings,
    batch: ContactBatch,
    count: int,
    substep: int,
    traits: Traits,
    joints: Joints,
    joined: int,
    touches: Touches,
    outlines: Outlines,
) -> None:
    """Take one substep, as in b2World::Step; the solver starts from impulses of the previous substep (STEP_RATIO)."""
    for k in range(count):
        if batch[k, DYNAMIC] == MOVED:
            _push(base + SLOTS + SLOT * k, batch, k)
    inverse = _ONE / settings.dt
    for step in (base + STEP, base + SOLVER_DEF, base + SOLVER_DATA):
        at.store_f4(step + at.STEP_DT, settings.dt)
        at.store_f4(step + at.STEP_INVERSE_DT, inverse)
        at.store_f4(step + at.STEP_RATIO, inverse * settings.dt if substep else _ZERO)
        at.store_i4(step + at.STEP_VELOCITY, settings.velocity_iterations)
        at.store_i4(step + at.STEP_POSITION, settings.position_iterations)
        at.store_u1(step + at.STEP_WARM, 1)
    at.collide(base + at.WORLD_MANAGER)
    solve_islands(base, settings, traits, joints, joined, touches)
    if joints is not None:
        measure_forces(base, inverse, joints, joined)
    if settings.continuous and may_hit(base, outlines):
        at.solve_impacts(base, base + STEP)
    if touches is not None:
        note_sensors(base)


@noinline_kernel
def _push(body: int, batch: ContactBatch, k: int) -> None:
    """b2Body::ApplyLinearImpulse at the centre and ApplyAngularImpulse; zero impulses are skipped."""
    if batch[k, JX] != 0 or batch[k, JY] != 0:
        inverse, velocity = at.load_f4(body + at.BODY_INVERSE_MASS), body + at.BODY_VELOCITY
        at.store_f4(velocity, at.load_f4(velocity) + inverse * batch[k, JX])
        at.store_f4(velocity + 4, at.load_f4(velocity + 4) + inverse * batch[k, JY])
    if batch[k, JTURN] != 0:
        turn = at.load_f4(body + at.BODY_INVERSE_INERTIA) * batch[k, JTURN]
        at.store_f4(body + at.BODY_OMEGA, at.load_f4(body + at.BODY_OMEGA) + turn)


@noinline_kernel
def _check_travel(base: int, batch: ContactBatch, count: int) -> int:
    for k in range(count):
        position = base + SLOTS + SLOT * k + at.BODY_POSITION
        x, y = at.load_f4(position) - batch[k, X], at.load_f4(position + 4) - batch[k, Y]
        if batch[k, DYNAMIC] == MOVED and x * x + y * y > batch[k, MAX_TRAVEL] * batch[k, MAX_TRAVEL]:
            return ABANDONED
    return SOLVED


@noinline_kernel
def _read(base: int, batch: ContactBatch, count: int) -> None:
    for k in range(count):
        body = base + SLOTS + SLOT * k
        if batch[k, DYNAMIC] != 0:
            batch[k, X] = at.load_f4(body + at.BODY_POSITION)
            batch[k, Y] = at.load_f4(body + at.BODY_POSITION + 4)
            batch[k, ANGLE] = at.load_f4(body + at.BODY_ANGLE)
            batch[k, VX] = at.load_f4(body + at.BODY_VELOCITY)
            batch[k, VY] = at.load_f4(body + at.BODY_VELOCITY + 4)
            batch[k, OMEGA] = at.load_f4(body + at.BODY_OMEGA)


@noinline_kernel
def _reset(base: int, count: int) -> None:
    """Make the world empty again, faster than destroying its bodies, and reset its tree.

    The tree takes nodes from a free list, and the order of contacts follows the numbers of nodes: without a reset,
    results would depend on previous steps.
    """
    manager = base + at.WORLD_MANAGER
    contact = at.load_i8(manager + at.MANAGER_CONTACTS)
    while contact:
        following = at.load_i8(contact + at.CONTACT_NEXT)
        at.destroy_contact(contact, base)
        contact = following
    at.store_i8(manager + at.MANAGER_CONTACTS, 0)
    at.store_i4(manager + at.MANAGER_CONTACT_COUNT, 0)
    at.store_i8(base + at.WORLD_BODIES, 0)
    at.store_i4(base + at.WORLD_BODY_COUNT, 0)
    at.store_i4(manager + at.PROXY_COUNT, 0)
    at.store_i4(manager + at.MOVE_COUNT, 0)
    at.store_i4(manager + at.TREE_ROOT, -1)
    at.store_i4(manager + at.TREE_COUNT, 0)
    at.store_i4(manager + at.TREE_FREE, 0)
    at.store_i4(manager + at.TREE_INSERTIONS, 0)
    node = at.load_i8(manager + at.TREE_NODES)
    for following_node in range(1, min(2 * count, at.load_i4(manager + at.TREE_CAPACITY) - 1) + 1):
        at.store_i4(node + at.NODE_NEXT, following_node)
        at.store_i4(node + at.NODE_HEIGHT, -1)
        node += at.NODE_SIZE
