"""Is the installed Box2D the one whose insides the native bridge knows? Asked before its memory is touched.

Objects made by pybox2d's public interface are read at the offsets of `layout`, and Box2D's constructors
run in a guarded buffer; whatever differs is named. Only the numbers of b2TimeStep and b2ContactSolverDef, which
no public object shows, rest mostly on the version, and on the tests that compare the bridges.
"""

import ctypes
import functools
import math
from collections.abc import Iterable, Iterator
from typing import Any

import Box2D
import numpy as np

from . import layout as at
from .scene import IncompatibleBox2D

VERSION = "2.3.10"
_Check = tuple[str, Any, Any]  # offset's name, found, expected


@functools.cache
def _report() -> str:
    """What is wrong with the installed Box2D; empty if nothing is."""
    if np.dtype(np.intp).itemsize != 8:
        return "pointers are not 8 bytes"
    if not Box2D.__version__.startswith(VERSION):
        return f"its version is {Box2D.__version__}, not {VERSION}"
    if missing := at.missing_symbols():
        return f"it does not export {', '.join(missing)}"
    sample = Sample()
    for check in (_definition, _body, _links, _fixture, _world, _tree, _contacts, _construction, _solver):
        for name, found, expected in check(sample):
            if found != expected:
                return f"{name} holds {found}, not {expected}"
    return ""


def verify() -> None:
    """Raise IncompatibleBox2D, naming the symbol or offset, unless the native bridge fits this Box2D."""
    if report := _report():
        raise IncompatibleBox2D(
            f"the native bridge does not fit Box2D {Box2D.__version__} ({at.FILE}): {report}. "
            'Use the portable bridge: Contacts(bridge="portable").'
        )


def _read(address: int, offset: str, kind: type = ctypes.c_float, extra: int = 0) -> Any:
    return kind.from_address(address + getattr(at, offset) + extra).value  # type: ignore[attr-defined]


def _floats(thing: Any, **expected: Iterable[float]) -> Iterator[_Check]:
    for name, values in expected.items():
        for k, value in enumerate(values):
            yield name, _read(int(thing.this), name, extra=4 * k), float(np.float32(value))


def _pointer(thing: Any, name: str, target: Any) -> _Check:
    return name, _read(int(thing.this), name, ctypes.c_int64), int(target.this) if target else 0


def _integer(thing: Any, name: str, expected: int) -> _Check:
    return name, _read(int(thing.this), name, ctypes.c_int32), expected


class Sample:
    """A static box on which a moving circle and a moving box lie, stepped once; all numbers are different."""

    def __init__(self) -> None:
        self.world = Box2D.b2World(gravity=(0, 0), continuousPhysics=False)
        self.floor = self.world.CreateStaticBody(position=(0, -1), shapes=Box2D.b2PolygonShape(box=(9, 1)))
        self.disc = self.world.CreateDynamicBody(
            position=(1, 0.4), angle=0.5, linearVelocity=(0.1, -3), angularVelocity=2
        )
        shape = Box2D.b2CircleShape(radius=0.5, pos=(0.1, 0.05))
        self.disc.CreateFixture(shape=shape, density=2, friction=0.3, restitution=0.1)
        self.crate = self.world.CreateDynamicBody(position=(-3, 0.19), linearVelocity=(1, -4))
        self.crate.CreateFixture(shape=Box2D.b2PolygonShape(box=(0.75, 0.2)), density=1)
        self.start = (*self.disc.worldCenter, self.disc.angle)
        self.world.Step(1 / 60, 10, 10)


def _definition(sample: Sample) -> Iterator[_Check]:
    definition = Box2D.b2BodyDef(
        type=Box2D.b2_dynamicBody,
        position=(1, 2),
        angle=3,
        linearVelocity=(4, 5),
        angularVelocity=6,
        linearDamping=7,
        angularDamping=8,
    )
    yield _integer(definition, "DEF_TYPE", at.MOVING)
    yield from _floats(definition, DEF_POSITION=(1, 2), DEF_ANGLE=(3,), DEF_VELOCITY=(4, 5), DEF_OMEGA=(6,))
    yield from _floats(definition, DEF_LINEAR_DAMPING=(7,), DEF_ANGULAR_DAMPING=(8,))


def _body(sample: Sample) -> Iterator[_Check]:
    disc = sample.disc
    yield _integer(sample.floor, "BODY_TYPE", at.STATIC)
    yield _integer(disc, "BODY_TYPE", at.MOVING)
    yield "BODY_FLAGS", _read(int(disc.this), "BODY_FLAGS", ctypes.c_uint16) & ~at.IN_ISLAND, 0x26  # awake
    *center, angle = sample.start
    yield from _floats(disc, BODY_CENTER0=center, BODY_ANGLE0=(angle,), BODY_LOCAL=disc.localCenter)
    yield from _floats(disc, BODY_CENTER=disc.worldCenter, BODY_POSITION=disc.position)
    yield from _floats(disc, BODY_ANGLE=(disc.angle,))
    yield from _floats(disc, BODY_SIN=(disc.transform.q.s,), BODY_COS=(disc.transform.q.c,))
    yield from _floats(disc, BODY_VELOCITY=disc.linearVelocity, BODY_OMEGA=(disc.angularVelocity,))
    yield from _floats(disc, BODY_INVERSE_MASS=(float(1 / np.float32(disc.mass)),))
    inertia = disc.inertia - disc.mass * disc.localCenter.lengthSquared
    found = _read(int(disc.this), "BODY_INVERSE_INERTIA")
    yield "BODY_INVERSE_INERTIA", math.isclose(found, 1 / inertia, rel_tol=1e-4), True


def _links(sample: Sample) -> Iterator[_Check]:
    disc, floor = sample.disc, sample.floor
    yield _pointer(disc, "BODY_WORLD", sample.world)
    yield _pointer(disc, "BODY_NEXT", floor)
    yield _pointer(disc, "BODY_FIXTURES", disc.fixtures[0])
    yield _integer(disc, "BODY_FIXTURE_COUNT", 1)
    edge = disc.contacts[0]
    yield _pointer(disc, "BODY_EDGES", edge)
    yield _pointer(edge, "EDGE_OTHER", floor)
    yield _pointer(edge, "EDGE_CONTACT", edge.contact)
    yield _pointer(floor.contacts[1], "EDGE_NEXT", floor.contacts[0])  # pybox2d lists the newest last
    yield _integer(disc, "BODY_INDEX", 0)  # first in its island, which is solved after the crate's
    yield _integer(floor, "BODY_INDEX", 1)


def _fixture(sample: Sample) -> Iterator[_Check]:
    fixture, box = sample.disc.fixtures[0], sample.crate.fixtures[0].shape
    yield from _floats(fixture, FIXTURE_DENSITY=(2,), FIXTURE_FRICTION=(0.3,), FIXTURE_RESTITUTION=(0.1,))
    yield _pointer(fixture, "FIXTURE_BODY", sample.disc)
    yield _pointer(fixture, "FIXTURE_SHAPE", fixture.shape)
    yield _integer(fixture, "FIXTURE_PROXY_COUNT", 1)
    proxy = _read(int(fixture.this), "FIXTURE_PROXIES", ctypes.c_int64)
    near = proxy % 8 == 0 and abs(proxy - int(fixture.this)) < 1 << 40  # safe to follow
    yield "FIXTURE_PROXIES", near and ctypes.c_int64.from_address(proxy + 16).value, int(fixture.this)
    yield _integer(fixture.shape, "SHAPE_TYPE", at.CIRCLE)
    yield _integer(box, "SHAPE_TYPE", at.POLYGON)
    yield from _floats(fixture.shape, CIRCLE_RADIUS=(0.5,))
    yield from _floats(box, POLYGON_VERTICES=(-0.75, -0.2, 0.75, -0.2, 0.75, 0.2, -0.75, 0.2))


def _world(sample: Sample) -> Iterator[_Check]:
    world, manager = sample.world, sample.world.contactManager
    yield _pointer(world, "WORLD_BODIES", sample.crate)
    yield _integer(world, "WORLD_BODY_COUNT", 3)
    yield "WORLD_MANAGER", int(manager.this), int(world.this) + at.WORLD_MANAGER
    yield "b2BlockAllocator", int(manager.allocator), int(world.this)
    yield "b2BroadPhase", int(manager.broadPhase.this), int(manager.this)
    yield _pointer(manager, "MANAGER_CONTACTS", world.contacts[1])
    yield _integer(manager, "MANAGER_CONTACT_COUNT", 2)
    yield _pointer(manager, "MANAGER_FILTER", manager.contactFilter)
    yield _pointer(manager, "MANAGER_LISTENER", manager.contactListener)


def _tree(sample: Sample) -> Iterator[_Check]:
    tree = sample.world.contactManager.broadPhase
    yield _integer(tree, "PROXY_COUNT", 3)
    yield _integer(tree, "MOVE_COUNT", 0)
    yield _integer(tree, "TREE_COUNT", 5)
    yield _integer(tree, "TREE_CAPACITY", 16)
    yield _integer(tree, "TREE_FREE", 5)
    yield _integer(tree, "TREE_INSERTIONS", 3)
    nodes = _read(int(tree.this), "TREE_NODES", ctypes.c_int64)
    index = _read(int(tree.this), "TREE_ROOT", ctypes.c_int32)
    yield "TREE_NODES", nodes % 8 == 0 and abs(nodes - int(tree.this)) < 1 << 40, True  # safe to follow
    yield "TREE_ROOT", 0 <= index < 5, True
    for proxy in (0, 1, 3):  # 2 and 4 are branches
        fat = tree.GetFatAABB(proxy)
        corners = (*fat.lowerBound, *fat.upperBound)
        yield "NODE_SIZE", tuple((ctypes.c_float * 4).from_address(nodes + proxy * at.NODE_SIZE)), corners
    yield "NODE_HEIGHT", _read(nodes + at.NODE_SIZE * index, "NODE_HEIGHT", ctypes.c_int32), tree.treeHeight
    yield "NODE_NEXT", _read(nodes + at.NODE_SIZE * 5, "NODE_NEXT", ctypes.c_int32), 6


def _contacts(sample: Sample) -> Iterator[_Check]:
    first, second = sample.world.contacts
    yield _pointer(second, "CONTACT_NEXT", first)
    for contact in first, second:
        yield "CONTACT_FLAGS", _read(int(contact.this), "CONTACT_FLAGS", ctypes.c_int32) & at.SOLID, at.SOLID
        yield _pointer(contact, "CONTACT_FIXTURE_A", contact.fixtureA)
        yield _pointer(contact, "CONTACT_FIXTURE_B", contact.fixtureB)


def _call(symbol: str, *addresses: int) -> None:
    ctypes.CDLL(at.FILE)[symbol](*map(ctypes.c_void_p, addresses))


def _construct(symbol: str, size: int, *addresses: int) -> tuple[Any, bool]:
    """Run a constructor in a buffer; also whether it wrote the last word before `size` and nothing beyond."""
    buffer = (ctypes.c_uint8 * (size + 64))(*[0xA5] * (size + 64))
    _call(symbol, ctypes.addressof(buffer), *addresses)
    return buffer, bytes(buffer[size:]) == b"\xa5" * 64 and bytes(buffer[size - 8 : size]) != b"\xa5" * 8


def _construction(sample: Sample) -> Iterator[_Check]:
    """The sizes of what is constructed in place."""
    zeros = ctypes.addressof(ctypes.c_int64())
    definition = Box2D.b2BodyDef()
    _, fits = _construct("_ZN6b2BodyC1EPK9b2BodyDefP7b2World", at.BODY_SIZE, int(definition.this), 0)
    yield "BODY_SIZE", fits, True
    world, fits = _construct("_ZN7b2WorldC1ERK6b2Vec2", at.WORLD_SIZE, zeros)
    _call("_ZN7b2WorldD1Ev", ctypes.addressof(world))
    yield "WORLD_SIZE", fits, True
    border = bytes(world[at.WORLD_STACK - 1 : at.WORLD_STACK + 1])
    yield "WORLD_STACK", border, b"\x00\xa5"  # free lists, zero, before; data, as found, after


def _solver(sample: Sample) -> Iterator[_Check]:
    """Hand both contacts to a b2ContactSolver: it copies their impulses, times the ratio of the steps."""
    contacts = (ctypes.c_int64 * 2)(*(int(contact.this) for contact in reversed(sample.world.contacts)))
    places = (ctypes.c_float * 12)()
    definition = (ctypes.c_uint8 * 64)()
    values: dict[str, tuple[type, float]] = {
        "STEP_RATIO": (ctypes.c_float, 0.5),
        "STEP_WARM": (ctypes.c_uint8, 1),
        "SOLVER_CONTACTS": (ctypes.c_int64, ctypes.addressof(contacts)),
        "SOLVER_COUNT": (ctypes.c_int32, 2),
        "SOLVER_POSITIONS": (ctypes.c_int64, ctypes.addressof(places)),
        "SOLVER_VELOCITIES": (ctypes.c_int64, ctypes.addressof(places)),
        "SOLVER_STACK": (ctypes.c_int64, int(sample.world.this) + at.WORLD_STACK),
    }
    for name, (kind, value) in values.items():
        kind.from_buffer(definition, getattr(at, name)).value = value  # type: ignore[attr-defined]
    solver = (ctypes.c_uint8 * 128)()
    address = ctypes.addressof(solver)
    _call("_ZN15b2ContactSolverC1EP18b2ContactSolverDef", address, ctypes.addressof(definition))
    constraints = _read(address, "SOLVER_CONSTRAINTS", ctypes.c_int64)
    data = int(sample.world.this) + at.WORLD_STACK
    checks: list[_Check] = [("SOLVER_CONSTRAINTS", data < constraints < data + 1024, True)]
    if checks[0][1]:
        checks += _impulses(constraints, sample)
    _call("_ZN15b2ContactSolverD1Ev", address)
    yield from checks


def _impulses(constraints: int, sample: Sample) -> Iterator[_Check]:
    for k, contact in enumerate(reversed(sample.world.contacts)):  # the first has two points
        for name, point in zip(("IMPULSES_0", "IMPULSES_1"), contact.manifold.points, strict=False):
            for extra, impulse in (0, point.normalImpulse), (4, point.tangentImpulse):
                found = _read(constraints + k * at.CONSTRAINT_SIZE, name, extra=extra)
                yield "CONSTRAINT_SIZE" if k else name, found, impulse / 2
