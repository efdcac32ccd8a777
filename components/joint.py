"""Joints between solids: welds, ropes and rods. Mechanics create and end them in any tick; physics solves them."""

import math
from typing import Any

from outlast.ecs import Array, Component, Event, column, kernel

from .body import Solid


class Weld(Component):
    """A weld to another solid: both move as one body, and do not touch each other. Created by `hold`.

    Physics ends welds of dead solids, and welds to dead entities, to entities that are not solid, and to itself.
    """

    requires = (Solid,)
    other: Array = column("i4", fill=-1, unit="entity")  # the held solid; -1: none
    x: Array = column("f4")  # metres, centre of the other solid in its own frame
    y: Array = column("f4")
    angle: Array = column("f4")  # radians, angle of the other solid, from its own
    hertz: Array = column("f4")  # 0: rigid; otherwise the angle yields like a spring of that frequency
    damping: Array = column("f4")  # damping ratio of that spring; 1: without overshoot
    breaks_at: Array = column("f4")  # newtons, the force at which it ends; 0: never
    force: Array = column("f4")  # newtons, the largest force in this tick; written by physics


class Rope(Component):
    """A rope to another solid, which limits their distance. Created by `tie`; it ends like a weld.

    A rod keeps the distance; with hertz, like a spring. The solids still touch each other.
    """

    requires = (Solid,)
    other: Array = column("i4", fill=-1, unit="entity")  # the solid at the other end; -1: none
    length: Array = column("f4")  # metres between the two ends
    x: Array = column("f4")  # metres, its own end in its own frame
    y: Array = column("f4")
    other_x: Array = column("f4")  # metres, the other end in the other solid's frame
    other_y: Array = column("f4")
    rod: Array = column("u1", high=1)  # 1: a rod, 0: a rope
    hertz: Array = column("f4")  # of a rod: 0: rigid; otherwise it yields like a spring of that frequency
    damping: Array = column("f4")  # damping ratio of that spring
    breaks_at: Array = column("f4")  # newtons, the force at which it ends; 0: never
    force: Array = column("f4")  # newtons, the largest force in this tick; written by physics


class WeldBroken(Event, capacity=Weld, who="solid", whom="other"):
    """A weld ended because the force on it was too large."""

    solid: Array = column("i4", unit="entity")  # the solid with the weld
    other: Array = column("i4", unit="entity")
    force: Array = column("f4", unit="newtons")


class RopeBroken(Event, capacity=Rope, who="solid", whom="other"):
    """A rope or a rod ended because the force on it was too large."""

    solid: Array = column("i4", unit="entity")  # the solid with the rope
    other: Array = column("i4", unit="entity")
    force: Array = column("f4", unit="newtons")


@kernel
def hold(welds: Any, body: Any, e: int, other: int) -> None:
    """Weld another solid to solid `e` in their present poses, instead of the one that it held. welds: `Write[Weld]`."""
    x, y = body.x[other] - body.x[e], body.y[other] - body.y[e]
    welds.other[e], welds.angle[e] = other, body.angle[other] - body.angle[e]
    welds.x[e] = x * body.cosine[e] + y * body.sine[e]
    welds.y[e] = y * body.cosine[e] - x * body.sine[e]


@kernel
def tie(ropes: Any, body: Any, e: int, other: int) -> None:
    """Tie solid `e` to another one, centre to centre, by a rope of their present distance. ropes: `Write[Rope]`."""
    ropes.other[e], ropes.length[e] = other, math.hypot(body.x[other] - body.x[e], body.y[other] - body.y[e])
    ropes.x[e], ropes.y[e], ropes.other_x[e], ropes.other_y[e] = 0, 0, 0, 0


@kernel
def let_go(joints: Any, e: int) -> None:
    """End the weld or the rope of solid `e`, if it has one. joints: `Write[Weld]` or `Write[Rope]`."""
    joints.other[e] = -1
