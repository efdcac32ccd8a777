"""Contacts of a tick, for the native backend: recorded after every substep, and by a callback in impacts."""

import functools

import numpy as np
from numpy.typing import NDArray

from outlast.ecs.kernels.jit import callback, noinline_kernel

from . import layout as at
from .batch import AT_X, AT_Y, CAPACITY, HIGH, IMPULSE, LOW
from .workspace import CONTACTS, FUNCTIONS, LISTENER, POINTS, SLOT, SLOTS, SOLVER, TOUCH, TOUCH_COUNT, TOUCH_KEYS

_ZERO, _HALF = np.float32(0), np.float32(0.5)


@noinline_kernel
def _entry(base: int, low: int, high: int) -> int:
    return base + TOUCH + 24 * (high * (high - 1) // 2 + low)


@noinline_kernel
def note(base: int, contact: int, impulse: np.float32) -> None:
    """Record that the two bodies of a contact touch, with the impulse between them."""
    fixture_a, fixture_b = at.load_i8(contact + at.CONTACT_FIXTURE_A), at.load_i8(contact + at.CONTACT_FIXTURE_B)
    a, b = at.load_i8(fixture_a + at.FIXTURE_BODY), at.load_i8(fixture_b + at.FIXTURE_BODY)
    first, second = (a - base - SLOTS) // SLOT, (b - base - SLOTS) // SLOT
    low, high = min(first, second), max(first, second)
    entry = _entry(base, low, high)
    known = at.load_i4(entry)
    if not known:
        count = at.load_i8(base + TOUCH_COUNT)
        at.store_i8(base + TOUCH_KEYS + 8 * count, low * CAPACITY + high)
        at.store_i8(base + TOUCH_COUNT, count + 1)
        at.store_i4(entry, 1)
        at.store_f4(entry + 4, _ZERO)
    at.store_f4(entry + 4, at.load_f4(entry + 4) + impulse)
    if known and impulse <= at.load_f4(entry + 8):
        return
    at.store_f4(entry + 8, impulse)
    points, count = base + POINTS, at.load_i4(contact + at.CONTACT_MANIFOLD + at.MANIFOLD_COUNT)
    if count == 0:  # a sensor: the position of the other body
        body = b if at.load_u1(fixture_a + at.FIXTURE_SENSOR) else a
        x, y = at.load_f4(body + at.BODY_POSITION), at.load_f4(body + at.BODY_POSITION + 4)
    else:
        radius_a = at.load_f4(at.load_i8(fixture_a + at.FIXTURE_SHAPE) + at.CIRCLE_RADIUS)
        radius_b = at.load_f4(at.load_i8(fixture_b + at.FIXTURE_SHAPE) + at.CIRCLE_RADIUS)
        place_a, place_b = a + at.BODY_POSITION, b + at.BODY_POSITION
        at.find_points(points, contact + at.CONTACT_MANIFOLD, place_a, radius_a, place_b, radius_b)
        x, y = at.load_f4(points + 8), at.load_f4(points + 12)
        if count == 2:
            x, y = (x + at.load_f4(points + 16)) * _HALF, (y + at.load_f4(points + 20)) * _HALF
    at.store_f4(entry + 12, x)
    at.store_f4(entry + 16, y)


@noinline_kernel
def note_island(base: int, contacts: int) -> None:
    """Record the contacts of a solved island, while its solver still has their impulses."""
    constraint = at.load_i8(base + SOLVER + at.SOLVER_CONSTRAINTS)
    for k in range(contacts):
        impulse = at.load_f4(constraint + at.IMPULSES_0)
        if at.load_i4(constraint + at.CONSTRAINT_POINTS) == 2:
            impulse += at.load_f4(constraint + at.IMPULSES_1)
        note(base, at.load_i8(base + CONTACTS + 8 * k), impulse)
        constraint += at.CONSTRAINT_SIZE


@noinline_kernel
def note_sensors(base: int) -> None:
    """Record overlaps with sensors, at the end of a substep."""
    contact = at.load_i8(base + at.WORLD_MANAGER + at.MANAGER_CONTACTS)
    while contact:
        a, b = at.load_i8(contact + at.CONTACT_FIXTURE_A), at.load_i8(contact + at.CONTACT_FIXTURE_B)
        sensor = at.load_u1(a + at.FIXTURE_SENSOR) | at.load_u1(b + at.FIXTURE_SENSOR)
        if sensor and at.load_i4(contact + at.CONTACT_FLAGS) & at.TOUCHING:
            note(base, contact, _ZERO)
        contact = at.load_i8(contact + at.CONTACT_NEXT)


def _post_solve(listener: int, contact: int, impulse: int) -> None:
    """b2ContactListener::PostSolve, which Box2D calls for impacts, which it solves itself."""
    total = at.load_f4(impulse)
    if at.load_i4(impulse + at.IMPULSE_COUNT) == 2:
        total += at.load_f4(impulse + 4)
    note(at.load_i8(listener + 8), contact, total)


@functools.cache
def _callback() -> int:
    return callback(_post_solve, "intp", "intp", "intp")


def listen(workspace: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Record impacts in a workspace. Return the workspace."""
    workspace[FUNCTIONS + 8 * at.POST_SOLVE :][:8].view(np.int64)[0] = _callback()
    return workspace


@noinline_kernel
def watch(base: int, listening: bool) -> None:
    """Begin or end the recording of touches."""
    at.store_i8(base + at.WORLD_MANAGER + at.MANAGER_LISTENER, base + LISTENER if listening else 0)


@noinline_kernel
def read_touches(base: int, touches: NDArray[np.float32]) -> None:
    """Write the recorded touches into `touches`, in order of bodies."""
    count, keys = at.load_i8(base + TOUCH_COUNT), base + TOUCH_KEYS
    for k in range(1, count):  # insertion sort, for few elements
        key, place = at.load_i8(keys + 8 * k), k
        while place > 0 and at.load_i8(keys + 8 * (place - 1)) > key:
            at.store_i8(keys + 8 * place, at.load_i8(keys + 8 * (place - 1)))
            place -= 1
        at.store_i8(keys + 8 * place, key)
    touches[0, LOW] = count
    for k in range(min(count, touches.shape[0] - 1)):
        key = at.load_i8(keys + 8 * k)
        entry = _entry(base, key // CAPACITY, key % CAPACITY)
        touches[k + 1, LOW], touches[k + 1, HIGH] = key // CAPACITY, key % CAPACITY
        touches[k + 1, IMPULSE] = at.load_f4(entry + 4)
        touches[k + 1, AT_X], touches[k + 1, AT_Y] = at.load_f4(entry + 12), at.load_f4(entry + 16)


@noinline_kernel
def forget(base: int) -> None:
    """Clear the recorded touches."""
    for k in range(at.load_i8(base + TOUCH_COUNT)):
        key = at.load_i8(base + TOUCH_KEYS + 8 * k)
        at.store_i4(_entry(base, key // CAPACITY, key % CAPACITY), 0)
    at.store_i8(base + TOUCH_COUNT, 0)
