"""Joints between solids: welds, ropes and rods. Mechanics make and end them in any tick; physics solves them."""

import math
from typing import Any

from outlast.ecs import Array, Component, Event, column, kernel

from .body import Solid


class Weld(Component):
    """A weld to another solid: both move as one body, and do not touch each other. Made by `hold`.

    Physics ends a weld to something that is dead, to what is no solid, and to itself; and that of the dead.
    """

    requires = (Solid,)
    other: Array = column("i4", fill=-1, unit="entity")  # the solid that it holds; -1: none
    x: Array = column("f4")  # metres, the centre of the other one in its own frame
    y: Array = column("f4")
    angle: Array = column("f4")  # radians, of the other one, from its own
    hertz: Array = column("f4")  # 0: rigid; else the angle gives way like a spring of that frequency
    damping: Array = column("f4")  # damping ratio of that spring; 1: it does not overshoot
    breaks_at: Array = column("f4")  # newtons, beyond which it ends; 0: never
    force: Array = column("f4")  # newtons with which it held in this tick, at most; written by physics


class Rope(Component):
    """A rope to another solid, which may be a certain distance away, but not farther. Made by `tie`; it ends as a weld.

    A rod keeps the distance; with hertz, like a spring. Both ends touch each other as ever.
    """

    requires = (Solid,)
    other: Array = column("i4", fill=-1, unit="entity")  # the solid that it is tied to; -1: none
    length: Array = column("f4")  # metres between the two ends
    x: Array = column("f4")  # metres, its own end in its own frame
    y: Array = column("f4")
    other_x: Array = column("f4")  # metres, the other end in the other one's frame
    other_y: Array = column("f4")
    rod: Array = column("u1", high=1)  # 1: a rod, 0: a rope
    hertz: Array = column("f4")  # of a rod: 0: rigid; else it gives way like a spring of that frequency
    damping: Array = column("f4")  # damping ratio of that spring
    breaks_at: Array = column("f4")  # newtons, beyond which it ends; 0: never
    force: Array = column("f4")  # newtons with which it held in this tick, at most; written by physics


class WeldBroken(Event, capacity=Weld, who="solid", whom="other"):
    """A weld ended, as the force on it was larger than it bears."""

    solid: Array = column("i4", unit="entity")  # whose weld it was
    other: Array = column("i4", unit="entity")
    force: Array = column("f4", unit="newtons")


class RopeBroken(Event, capacity=Rope, who="solid", whom="other"):
    """A rope or a rod ended, likewise."""

    solid: Array = column("i4", unit="entity")  # whose rope it was
    other: Array = column("i4", unit="entity")
    force: Array = column("f4", unit="newtons")


@kernel
def hold(welds: Any, body: Any, e: int, other: int) -> None:
    """Weld another solid to solid `e` as the two are now, in place of what it held. welds: `Write[Weld]`."""
    x, y = body.x[other] - body.x[e], body.y[other] - body.y[e]
    welds.other[e], welds.angle[e] = other, body.angle[other] - body.angle[e]
    welds.x[e] = x * body.cosine[e] + y * body.sine[e]
    welds.y[e] = y * body.cosine[e] - x * body.sine[e]


@kernel
def tie(ropes: Any, body: Any, e: int, other: int) -> None:
    """Tie solid `e` to another one, centre to centre, by a rope as long as they are apart. ropes: `Write[Rope]`."""
    ropes.other[e], ropes.length[e] = other, math.hypot(body.x[other] - body.x[e], body.y[other] - body.y[e])
    ropes.x[e], ropes.y[e], ropes.other_x[e], ropes.other_y[e] = 0, 0, 0, 0


@kernel
def let_go(joints: Any, e: int) -> None:
    """End the weld or the rope of solid `e`, if it has one. joints: `Write[Weld]` or `Write[Rope]`."""
    joints.other[e] = -1
