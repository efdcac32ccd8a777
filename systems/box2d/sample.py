"""The sample of `verify` and `probe`: a small world made by pybox2d's public interface, and readers of its memory."""

import ctypes
import os
from collections.abc import Iterable, Iterator
from typing import Any

import Box2D
import numpy as np

from . import layout as at

Check = tuple[str, Any, Any]  # the offset's name, what was found there, what was expected


def read(address: int, offset: str, kind: type = ctypes.c_float, extra: int = 0) -> Any:
    """Read one number of an object, at the offset of that name in `layout`, plus `extra` bytes."""
    return kind.from_address(address + getattr(at, offset) + extra).value  # type: ignore[attr-defined]


def floats(item: Any, **expected: Iterable[float]) -> Iterator[Check]:
    """Check the floats at each of these offsets, one after the other."""
    for name, values in expected.items():
        for k, value in enumerate(values):
            yield name, read(int(item.this), name, extra=4 * k), float(np.float32(value))


def pointer(item: Any, name: str, target: Any) -> Check:
    """Check a pointer to another object, or to none."""
    return name, read(int(item.this), name, ctypes.c_int64), int(target.this) if target else 0


def integer(item: Any, name: str, expected: int) -> Check:
    """Check an integer of 4 bytes."""
    return name, read(int(item.this), name, ctypes.c_int32), expected


def readable(address: int, size: int) -> bool:
    """Return whether `size` bytes, at most 4096, can be read: if not, the operating system refuses to copy them."""
    ends = os.pipe()
    try:
        return int(ctypes.CDLL(None).write(ends[1], ctypes.c_void_p(address), ctypes.c_size_t(size))) == size
    finally:
        for end in ends:
            os.close(end)


class Sample:
    """A static box on which a moving circle and a moving box lie, stepped once; all numbers are different.

    Before that, three others were made and destroyed. moved: MOVE_COUNT before the step. counts: see _Listener.
    wedge: a polygon without a body.
    """

    def __init__(self) -> None:
        self.world = Box2D.b2World(gravity=(0, 0), continuousPhysics=False)
        self.floor = self.world.CreateStaticBody(
            position=(0, -1), shapes=Box2D.b2PolygonShape(box=(9, 1)), linearDamping=0.2, angularDamping=0.7
        )
        self.disc = self.world.CreateDynamicBody(
            position=(1, 0.4), angle=0.5, linearVelocity=(0.1, -3), angularVelocity=2
        )
        shape = Box2D.b2CircleShape(radius=0.5, pos=(0.1, 0.05))
        self.disc.CreateFixture(
            shape=shape, density=2, friction=0.3, restitution=0.1, userData=self, categoryBits=3, maskBits=5
        )
        spares = [self.world.CreateStaticBody(position=(20, y), shapes=Box2D.b2CircleShape()) for y in range(3)]
        self.crate = self.world.CreateDynamicBody(position=(-3, 0.19), linearVelocity=(1, -4))
        self.crate.CreateFixture(shape=Box2D.b2PolygonShape(box=(0.75, 0.2)), density=1)
        for spare in spares:
            self.world.DestroyBody(spare)
        self.start = (*self.disc.worldCenter, self.disc.angle)
        self.moved = read(int(self.world.contactManager.this), "MOVE_COUNT", ctypes.c_int32)
        self.world.contactListener = self.listener = _Listener()
        self.world.Step(1 / 60, 10, 10)
        self.counts = self.listener.counts
        self.disc.fixtures[0].sensor = True
        self.joined, self.joints = _joined()
        self.wedge = Box2D.b2PolygonShape(vertices=[(0.1, 0.2), (1.5, 0.3), (0.4, 0.9)])


class _Listener(Box2D.b2ContactListener):  # type: ignore[misc]
    """The numbers of impulses that Box2D reports: found, and expected."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: list[tuple[int, int]] = []

    def PostSolve(self, contact: Any, impulse: Any) -> None:  # noqa: N802  # its name in Box2D
        found = read(int(impulse.this), "IMPULSE_COUNT", ctypes.c_int32)
        self.counts.append((found, len(impulse.normalImpulses)))


def _joined() -> tuple[Any, list[Any]]:
    """Return two bodies joined by a weld, a rod and a rope, stepped once; and the three joints."""
    world = Box2D.b2World(gravity=(0, 0))
    first, second = (world.CreateDynamicBody(position=(x, x / 4), angle=x / 6, linearVelocity=(x, 1)) for x in (1, 3))
    for body in first, second:
        body.CreateFixture(shape=Box2D.b2CircleShape(radius=0.5), density=1)
    ends = {"bodyA": first, "bodyB": second, "localAnchorA": (0.1, 0.2), "localAnchorB": (0.3, 0.4)}
    spring = {"frequencyHz": 1.6, "dampingRatio": 0.7}
    weld = world.CreateWeldJoint(**ends, **spring, referenceAngle=0.9, collideConnected=True)
    rod = world.CreateDistanceJoint(**ends, **spring, length=1.5)
    rope = world.CreateRopeJoint(**ends, maxLength=1.25)
    world.Step(1 / 60, 10, 10)
    return world, [weld, rod, rope]
