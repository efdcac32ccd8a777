"""A check of the installed Box2D: its memory layout must be that of the native backend.

Here, objects made by pybox2d's public interface are read at the offsets of `layout`; `probe` runs a few of Box2D's
functions on guarded memory. The error names the first offset that differs.
"""

import ctypes
import functools
import math
from collections.abc import Iterator

import Box2D
import numpy as np

from . import layout as at
from . import probe
from .batch import ROD, ROPE, WELD, IncompatibleBox2D
from .sample import Check, Sample, floats, integer, pointer, read, readable

VERSION = "2.3.10"


@functools.cache
def _report() -> str:
    """Return the fault of the installed Box2D; empty if it fits."""
    if np.dtype(np.intp).itemsize != 8:
        return "pointers are not 8 bytes"
    if not Box2D.__version__.startswith(VERSION):
        return f"its version is {Box2D.__version__}, not {VERSION}"
    if missing := at.missing_symbols():
        return f"it does not export {', '.join(missing)}"
    sample = Sample()
    for check in (*READ, *probe.RUN):
        for name, found, expected in check(sample):
            if found != expected:
                return f"{name} holds {found}, not {expected}"
    return ""


def verify() -> None:
    """Raise IncompatibleBox2D, naming the symbol or offset, unless the native backend fits this Box2D."""
    if report := _report():
        raise IncompatibleBox2D(
            f"the native backend does not fit Box2D {Box2D.__version__} ({at.FILE}): {report}. "
            'Use the portable backend: Physics(backend="portable").'
        )


def _definition(sample: Sample) -> Iterator[Check]:
    definition = Box2D.b2BodyDef(
        type=Box2D.b2_dynamicBody,
        position=(1, 2),
        angle=3,
        linearVelocity=(4, 5),
        angularVelocity=6,
        linearDamping=7,
        angularDamping=8,
        gravityScale=9,
    )
    yield integer(definition, "DEF_TYPE", at.MOVING)
    yield from floats(definition, DEF_POSITION=(1, 2), DEF_ANGLE=(3,), DEF_VELOCITY=(4, 5), DEF_OMEGA=(6,))
    yield from floats(definition, DEF_LINEAR_DAMPING=(7,), DEF_ANGULAR_DAMPING=(8,))
    yield "DEF_SIZE", read(int(definition.this), "DEF_SIZE", extra=-8), 9.0  # a size is checked by its last member


def _body(sample: Sample) -> Iterator[Check]:
    disc = sample.disc
    yield integer(sample.floor, "BODY_TYPE", at.STATIC)
    yield integer(disc, "BODY_TYPE", at.MOVING)
    yield "BODY_FLAGS", read(int(disc.this), "BODY_FLAGS", ctypes.c_uint16), 0x26 | at.IN_ISLAND  # awake
    *center, angle = sample.start
    yield from floats(disc, BODY_CENTER0=center, BODY_ANGLE0=(angle,), BODY_LOCAL=disc.localCenter)
    yield from floats(disc, BODY_CENTER=disc.worldCenter, BODY_POSITION=disc.position)
    yield from floats(disc, BODY_ANGLE=(disc.angle,))
    yield from floats(disc, BODY_SIN=(disc.transform.q.s,), BODY_COS=(disc.transform.q.c,))
    yield from floats(disc, BODY_VELOCITY=disc.linearVelocity, BODY_OMEGA=(disc.angularVelocity,))
    yield from floats(disc, BODY_INVERSE_MASS=(float(1 / np.float32(disc.mass)),))
    yield from floats(sample.floor, BODY_LINEAR_DAMPING=(0.2,), BODY_ANGULAR_DAMPING=(0.7,))
    inertia = disc.inertia - disc.mass * disc.localCenter.lengthSquared
    found = read(int(disc.this), "BODY_INVERSE_INERTIA")
    yield "BODY_INVERSE_INERTIA", math.isclose(found, 1 / inertia, rel_tol=1e-4), True


def _links(sample: Sample) -> Iterator[Check]:
    disc, floor = sample.disc, sample.floor
    yield pointer(disc, "BODY_WORLD", sample.world)
    yield pointer(disc, "BODY_NEXT", floor)
    yield pointer(disc, "BODY_FIXTURES", disc.fixtures[0])
    yield integer(disc, "BODY_FIXTURE_COUNT", 1)
    yield pointer(disc, "BODY_EDGES", disc.contacts[0])
    for edge, other in (disc.contacts[0], floor), (floor.contacts[0], disc):
        yield pointer(edge, "EDGE_OTHER", other)
        yield pointer(edge, "EDGE_CONTACT", edge.contact)
    yield pointer(floor.contacts[1], "EDGE_NEXT", floor.contacts[0])  # pybox2d lists the newest last
    yield integer(disc, "BODY_INDEX", 0)  # first in its island, which is solved after the crate's
    yield integer(floor, "BODY_INDEX", 1)


def _fixture(sample: Sample) -> Iterator[Check]:
    fixture, box = sample.disc.fixtures[0], sample.crate.fixtures[0].shape
    yield from floats(fixture, FIXTURE_FRICTION=(0.3,), FIXTURE_RESTITUTION=(0.1,))
    yield "FIXTURE_LAYER", read(int(fixture.this), "FIXTURE_LAYER", ctypes.c_uint16), 3
    yield "FIXTURE_HITS", read(int(fixture.this), "FIXTURE_HITS", ctypes.c_uint16), 5
    yield "FIXTURE_SENSOR", read(int(fixture.this), "FIXTURE_SENSOR", ctypes.c_uint8), 1
    yield pointer(fixture, "FIXTURE_BODY", sample.disc)
    yield pointer(fixture, "FIXTURE_SHAPE", fixture.shape)
    yield integer(fixture, "FIXTURE_PROXY_COUNT", 1)
    proxy = read(int(fixture.this), "FIXTURE_PROXIES", ctypes.c_int64)
    there = proxy % 8 == 0 and readable(proxy, at.PROXY_SIZE)
    yield "FIXTURE_PROXIES", there and ctypes.c_int64.from_address(proxy + 16).value, int(fixture.this)
    yield "FIXTURE_SIZE", read(int(fixture.this), "FIXTURE_SIZE", ctypes.c_int64, -8), id(sample)  # its userData
    yield "PROXY_SIZE", there and read(proxy, "PROXY_SIZE", ctypes.c_int32, -4), 1  # number of its leaf in the tree
    yield integer(fixture.shape, "SHAPE_TYPE", at.CIRCLE)
    yield integer(box, "SHAPE_TYPE", at.POLYGON)
    yield from floats(fixture.shape, CIRCLE_RADIUS=(0.5,))
    yield "CIRCLE_SIZE", read(int(fixture.shape.this), "CIRCLE_SIZE", extra=-8), float(np.float32(0.1))
    yield "POLYGON_SIZE", read(int(box.this), "POLYGON_SIZE", ctypes.c_int32, -8), 4  # number of corners
    yield integer(box, "POLYGON_COUNT", 4)
    yield from floats(box, POLYGON_VERTICES=(-0.75, -0.2, 0.75, -0.2, 0.75, 0.2, -0.75, 0.2))
    wedge = sample.wedge
    yield from floats(
        wedge, POLYGON_CENTROID=wedge.centroid, POLYGON_NORMALS=(each for n in wedge.normals for each in n)
    )


def _world(sample: Sample) -> Iterator[Check]:
    world, manager = sample.world, sample.world.contactManager
    yield pointer(world, "WORLD_BODIES", sample.crate)
    yield integer(world, "WORLD_BODY_COUNT", 3)
    yield "WORLD_MANAGER", int(manager.this), int(world.this) + at.WORLD_MANAGER
    yield "b2BlockAllocator", int(manager.allocator), int(world.this)
    yield "b2BroadPhase", int(manager.broadPhase.this), int(manager.this)
    yield pointer(manager, "MANAGER_CONTACTS", world.contacts[1])
    yield integer(manager, "MANAGER_CONTACT_COUNT", 2)
    yield pointer(manager, "MANAGER_FILTER", manager.contactFilter)
    yield pointer(manager, "MANAGER_LISTENER", manager.contactListener)


def _tree(sample: Sample) -> Iterator[Check]:
    tree = sample.world.contactManager.broadPhase
    yield integer(tree, "PROXY_COUNT", 3)
    yield "MOVE_COUNT", sample.moved, 6
    yield integer(tree, "MOVE_COUNT", 0)
    yield integer(tree, "TREE_COUNT", 5)
    yield integer(tree, "TREE_CAPACITY", 16)
    yield integer(tree, "TREE_FREE", 7)
    yield integer(tree, "TREE_INSERTIONS", 6)
    nodes = read(int(tree.this), "TREE_NODES", ctypes.c_int64)
    index = read(int(tree.this), "TREE_ROOT", ctypes.c_int32)
    yield "TREE_NODES", nodes % 8 == 0 and readable(nodes, 16 * at.NODE_SIZE), True
    yield "TREE_ROOT", index, 2
    for proxy in (0, 1, 9):  # the others are branches, or were leaves of destroyed bodies
        fat = tree.GetFatAABB(proxy)
        corners = (*fat.lowerBound, *fat.upperBound)
        yield "NODE_SIZE", tuple((ctypes.c_float * 4).from_address(nodes + proxy * at.NODE_SIZE)), corners
    yield "NODE_HEIGHT", read(nodes + at.NODE_SIZE * index, "NODE_HEIGHT", ctypes.c_int32), tree.treeHeight
    yield "NODE_NEXT", read(nodes + at.NODE_SIZE * 12, "NODE_NEXT", ctypes.c_int32), 13


def _contacts(sample: Sample) -> Iterator[Check]:
    first, second = sample.world.contacts
    yield pointer(second, "CONTACT_NEXT", first)
    for contact in first, second:
        yield integer(contact, "CONTACT_FLAGS", at.SOLID | at.IN_ISLAND)
        yield "CONTACT_MANIFOLD", int(contact.manifold.this), int(contact.this) + at.CONTACT_MANIFOLD
        count = read(int(contact.manifold.this), "MANIFOLD_COUNT", ctypes.c_int32)
        yield "MANIFOLD_COUNT", count, contact.manifold.pointCount
        yield pointer(contact, "CONTACT_FIXTURE_A", contact.fixtureA)
        yield pointer(contact, "CONTACT_FIXTURE_B", contact.fixtureB)


def _joints(sample: Sample) -> Iterator[Check]:
    weld, rod, rope = sample.joints
    ends = (0.1, 0.2, 0.3, 0.4)
    for joint, kind, touching in (weld, WELD, 1), (rod, ROD, 0), (rope, ROPE, 0):
        yield integer(joint, "JOINT_TYPE", kind)
        yield pointer(joint, "JOINT_BODY_A", joint.bodyA)
        yield pointer(joint, "JOINT_BODY_B", joint.bodyB)
        yield "JOINT_FLAG", read(int(joint.this), "JOINT_FLAG", ctypes.c_uint8), 1
        yield "JOINT_COLLIDES", read(int(joint.this), "JOINT_COLLIDES", ctypes.c_uint8), touching
        for edge, other in ("JOINT_EDGE_A", joint.bodyB), ("JOINT_EDGE_B", joint.bodyA):
            older = {rope: rod, rod: weld}.get(joint)
            behind = int(older.this) + getattr(at, edge) if older else 0
            expected = {"LINK_OTHER": int(other.this), "LINK_JOINT": int(joint.this), "LINK_NEXT": behind}
            found = {name: read(int(joint.this) + getattr(at, edge), name, ctypes.c_int64) for name in expected}
            wrong = [name for name in expected if found[name] != expected[name]]
            yield wrong[0] if len(wrong) == 1 else edge, found, expected
    yield "BODY_JOINTS", read(int(rope.bodyA.this), "BODY_JOINTS", ctypes.c_int64), int(rope.this) + at.JOINT_EDGE_A
    yield from floats(weld, WELD_SPRING=(1.6, 0.7), WELD_ANCHORS=ends, WELD_ANGLE=(0.9,))
    yield from floats(weld, WELD_IMPULSE=(*weld.GetReactionForce(1), weld.GetReactionTorque(1)))
    yield from floats(rod, ROD_SPRING=(1.6, 0.7), ROD_ANCHORS=ends, ROD_LENGTH=(1.5,))
    yield from floats(rope, ROPE_ANCHORS=ends, ROPE_LENGTH=(1.25,))
    for joint, name in (rod, "ROD"), (rope, "ROPE"):
        impulse = read(int(joint.this), f"{name}_IMPULSE")
        axis = [read(int(joint.this), f"{name}_AXIS", extra=extra) for extra in (0, 4)]
        force = (*joint.GetReactionForce(1),)
        yield f"{name}_AXIS", math.isclose(math.hypot(*axis), 1, rel_tol=1e-5), True
        yield f"{name}_IMPULSE", tuple(float(np.float32(impulse) * np.float32(each)) for each in axis), force


def _counts(sample: Sample) -> Iterator[Check]:
    found, expected = ([*each] for each in zip(*sample.counts, strict=True))
    yield "IMPULSE_COUNT", found, expected


READ = (_definition, _body, _links, _fixture, _world, _tree, _contacts, _counts, _joints)
