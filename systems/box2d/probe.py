"""Checks of members that public objects of Box2D do not show, by running its functions on harmless memory.

`verify` runs these last, after all readable members were found as expected.
"""

import ctypes
import mmap
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import Box2D

from . import layout as at
from .sample import Check, Sample, read

WORDS = 16  # in a definition for Box2D: more than it needs
POINTERS = ("SOLVER_CONTACTS", "SOLVER_POSITIONS", "SOLVER_VELOCITIES", "SOLVER_STACK")
PLACES = (*range(1, 64), *range(0x2000, 0x2040))  # addresses in units of 4 GiB, usually unused
STEP_WORDS = 3  # in a b2TimeStep, which comes first in a definition and in the solver


def _call(symbol: str, *addresses: int) -> None:
    ctypes.CDLL(at.FILE)[symbol](*map(ctypes.c_void_p, addresses))


def _construct(symbol: str, size: int, *addresses: int) -> tuple[Any, bool]:
    """Run a constructor in a buffer: the buffer, and whether the last word before `size` was written, and no more."""
    buffer = (ctypes.c_uint8 * (size + 64))(*[0xA5] * (size + 64))
    _call(symbol, ctypes.addressof(buffer), *addresses)
    return buffer, bytes(buffer[size:]) == b"\xa5" * 64 and bytes(buffer[size - 8 : size]) != b"\xa5" * 8


def _construction(sample: Sample) -> Iterator[Check]:
    """Check the sizes of what is constructed in place."""
    zeros = ctypes.c_int64()
    definition = Box2D.b2BodyDef()
    _, fits = _construct("_ZN6b2BodyC1EPK9b2BodyDefP7b2World", at.BODY_SIZE, int(definition.this), 0)
    yield "BODY_SIZE", fits, True
    world, fits = _construct("_ZN7b2WorldC1ERK6b2Vec2", at.WORLD_SIZE, ctypes.addressof(zeros))
    _call("_ZN7b2WorldD1Ev", ctypes.addressof(world))
    yield "WORLD_SIZE", fits, True
    border = bytes(world[at.WORLD_STACK - 1 : at.WORLD_STACK + 1])
    yield "WORLD_STACK", border, b"\x00\xa5"  # before it the free lists, zero; after it data, untouched


def _solver(sample: Sample) -> Iterator[Check]:
    """Check the pointers that b2ContactSolver's constructor reads: it keeps a copy of each in the solver.

    Each word of its definition is the address of an empty stack allocator, whose lower half, read as a number of
    contacts, is 0: reading any word as either is harmless.
    """
    for name in (*POINTERS, "SOLVER_COUNT", "STEP_DT", "STEP_RATIO", "STEP_VELOCITY", "STEP_WARM"):
        size = 8 if name in POINTERS else 1 if name == "STEP_WARM" else 4
        yield name, getattr(at, name) % size == 0 <= getattr(at, name) < 8 * WORDS, True
    with ExitStack() as decoys:
        other, *given = (decoys.enter_context(_decoy()) for _ in range(1 + len(POINTERS)))
        definition = (ctypes.c_int64 * WORDS)(*[other] * WORDS)
        for name, address in zip(POINTERS, given, strict=True):
            definition[getattr(at, name) // 8] = address
        with _solving(definition) as solver:
            kept = list((ctypes.c_int64 * WORDS).from_address(solver))[STEP_WORDS:]
    for name, address in zip(POINTERS, given, strict=True):
        yield name, address in kept, True


@contextmanager
def _decoy() -> Iterator[int]:
    """Return zeros, as large as a stack allocator, at an address whose lower 32 bits are 0."""
    system, size, flags = ctypes.CDLL(None), ctypes.c_size_t(at.WORLD_SIZE), mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS
    system.mmap.restype = ctypes.c_int64
    for k in PLACES:
        hint, access = ctypes.c_void_p(k << 32), mmap.PROT_READ | mmap.PROT_WRITE
        found = system.mmap(hint, size, access, flags, -1, ctypes.c_long(0))  # at the hint, if it is free
        try:
            if found == k << 32:
                yield found
                return
        finally:
            if found != -1:
                system.munmap(ctypes.c_void_p(found), size)
    raise MemoryError("none of these addresses is free")


@contextmanager
def _solving(definition: Any) -> Iterator[int]:
    """Construct a b2ContactSolver, yield its address, and destroy it."""
    solver = (ctypes.c_int64 * (2 * WORDS))()
    address = ctypes.addressof(solver)
    _call("_ZN15b2ContactSolverC1EP18b2ContactSolverDef", address, ctypes.addressof(definition))
    yield address
    _call("_ZN15b2ContactSolverD1Ev", address)


def _impulses(sample: Sample) -> Iterator[Check]:
    """Pass both contacts to a b2ContactSolver: it copies their impulses, times the ratio of the steps."""
    contacts = (ctypes.c_int64 * 2)(*(int(contact.this) for contact in reversed(sample.world.contacts)))
    places, definition = (ctypes.c_float * 12)(), (ctypes.c_int64 * WORDS)()
    values: dict[str, tuple[Any, float]] = {
        "STEP_RATIO": (ctypes.c_float, 0.5),
        "STEP_WARM": (ctypes.c_uint8, 1),
        "SOLVER_COUNT": (ctypes.c_int32, 2),
        "SOLVER_CONTACTS": (ctypes.c_int64, ctypes.addressof(contacts)),
        "SOLVER_POSITIONS": (ctypes.c_int64, ctypes.addressof(places)),
        "SOLVER_VELOCITIES": (ctypes.c_int64, ctypes.addressof(places)),
        "SOLVER_STACK": (ctypes.c_int64, int(sample.world.this) + at.WORLD_STACK),
    }
    for name, (kind, value) in values.items():  # pointers come last, so that no number overwrites one
        kind.from_buffer(definition, getattr(at, name)).value = value
    data = int(sample.world.this) + at.WORLD_STACK
    with _solving(definition) as solver:
        constraints = read(solver, "SOLVER_CONSTRAINTS", ctypes.c_int64)
        yield "SOLVER_CONSTRAINTS", data < constraints < data + 1024, True
        for k, contact in enumerate(reversed(sample.world.contacts)):  # the first contact has two points
            found = read(constraints + k * at.CONSTRAINT_SIZE, "CONSTRAINT_POINTS", ctypes.c_int32)
            yield "CONSTRAINT_SIZE" if k else "CONSTRAINT_POINTS", found, contact.manifold.pointCount
            for name, point in zip(("IMPULSES_0", "IMPULSES_1"), contact.manifold.points, strict=False):
                for extra, impulse in (0, point.normalImpulse), (4, point.tangentImpulse):
                    found = read(constraints + k * at.CONSTRAINT_SIZE, name, extra=extra)
                    yield "CONSTRAINT_SIZE" if k else name, found, impulse / 2


def _impacts(sample: Sample) -> Iterator[Check]:
    """Check that b2World::SolveTOI finds its numbers: a step without it, and then it, give the result of a step."""
    (_whole, expected), (parts, found) = (_thrown(continuous) for continuous in (True, False))
    step = (ctypes.c_int64 * WORDS)()
    for name, kind, value in ("STEP_DT", ctypes.c_float, 1 / 60), ("STEP_VELOCITY", ctypes.c_int32, 7):
        kind.from_buffer(step, getattr(at, name)).value = value
    _call("_ZN7b2World8SolveTOIERK10b2TimeStep", int(parts.this), ctypes.addressof(step))
    yield "STEP_VELOCITY", _motion(found), _motion(expected)
    yield "STEP_DT", (*found.position, found.angle), (*expected.position, expected.angle)


def _motion(body: Any) -> tuple[float, ...]:
    return (*body.linearVelocity, body.angularVelocity)


def _thrown(continuous: bool) -> tuple[Any, Any]:
    """Return a world with a turning disc, thrown at a wall and stepped once; and the disc."""
    world = Box2D.b2World(gravity=(0, 0), continuousPhysics=continuous)
    world.CreateStaticBody(position=(0.5, 0), shapes=Box2D.b2PolygonShape(box=(0.05, 2)))
    disc = world.CreateDynamicBody(position=(-0.5, 0), linearVelocity=(110, 9), angularVelocity=5)
    disc.CreateFixture(shape=Box2D.b2CircleShape(radius=0.2), density=1, friction=0.4)
    world.Step(1 / 60, 7, 10)
    return world, disc


def _solver_data(sample: Sample) -> Iterator[Check]:
    """Check the tables of positions and velocities that a joint reads: a weld changes the given velocities.

    All other words are the address of zeros.
    """
    for name in ("DATA_POSITIONS", "DATA_VELOCITIES"):
        yield name, 8 * STEP_WORDS <= getattr(at, name) < 8 * WORDS and getattr(at, name) % 8 == 0, True
    zeros = (ctypes.c_float * 64)()
    positions, velocities = (ctypes.c_float * 64)(*[0.5] * 6), (ctypes.c_float * 64)(*[0.25] * 6)
    data = (ctypes.c_int64 * WORDS)(*[0] * STEP_WORDS, *[ctypes.addressof(zeros)] * (WORDS - STEP_WORDS))
    ctypes.c_float.from_buffer(data, at.STEP_DT).value = 1 / 60
    for name, table in ("DATA_POSITIONS", positions), ("DATA_VELOCITIES", velocities):
        data[getattr(at, name) // 8] = ctypes.addressof(table)
    for function in "InitVelocityConstraints", "SolveVelocityConstraints", "SolvePositionConstraints":
        symbol = f"_ZN11b2WeldJoint{len(function)}{function}ERK12b2SolverData"
        _call(symbol, int(sample.joints[0].this), ctypes.addressof(data))
    yield "DATA_VELOCITIES", (any(each != 0.25 for each in velocities[:6]), any(zeros)), (True, False)
    yield "DATA_POSITIONS", any(each != 0.5 for each in positions[:6]), True


RUN = (_construction, _solver, _impulses, _impacts, _solver_data)
