"""Places, shapes and motion of entities."""

from typing import Any

import numpy as np

from outlast.ecs import Array, Component, Coupled, DeclarationError, Field, Layout, Singleton, column, kernel
from outlast.ecs.declarations.component import as_stored

ONE, ZERO = np.float32(1), np.float32(0)
HEADING, OUTLINE = ("angle", "cosine", "sine"), ("radius", "half_width", "half_height")
TURN = "turn a body by face(body, e, angle) of outlast.components.body"
BOUND = "the radius of the circle around the body decides its distance to walls"
MASS = "by itself, it changes nothing"
SPEED, SPIN = 10.0, 5.0  # metres a second, radians a second: scales that are seldom exceeded


class Body(Component):
    """Pose and velocity, world frame."""

    coupled = (Coupled(HEADING, HEADING, TURN),)
    x: Array = column("f4")  # metres
    y: Array = column("f4")
    angle: Array = column("f4")  # radians, unwrapped up to 10,000; 0 faces +x, counter-clockwise
    cosine: Array = column("f4", fill=1)  # cosine of angle
    sine: Array = column("f4")
    vx: Array = column("f4")  # metres/second
    vy: Array = column("f4")
    omega: Array = column("f4")  # radians/second

    def __init__(self, **fills: Any) -> None:
        """Take prefab values. Cosine and sine are computed from the angle."""
        if given := [name for name in HEADING[1:] if name in fills]:
            raise DeclarationError(f"Body({given[0]}=...): it follows from the angle; give that, as in Body(angle=0.5)")
        super().__init__(**fills)
        angle = as_stored("Body.angle", self.columns["angle"], fills.get("angle", 0))
        if angle.any():
            self.fills |= {"cosine": np.cos(angle), "sine": np.sin(angle)}


class Shape(Component):
    """Outline: a circle, or with radius 0 a rectangle along the body's own axes.

    It blocks sight and strikes, and cameras see only entities with one.
    """

    requires = (Body,)
    coupled = (Coupled(OUTLINE, ("bound",), BOUND, "room.compute_bounds"),)
    radius: Array = column("f4")  # metres
    half_width: Array = column("f4")
    half_height: Array = column("f4")
    bound: Array = column("f4")  # radius of the circle around the outline, computed at reset


class Solid(Component):
    """A body that takes part in contacts. Without this component, a body is intangible, as items are."""

    requires = (Body, Shape)
    coupled = (Coupled(("density",), ("mass", "inertia"), MASS, "physics.compute_mass"),)
    dynamic: Array = column("u1", high=1)  # 1: can be pushed; 0: static, as walls are
    density: Array = column("f4", fill=1)  # kilograms/square metre
    mass: Array = column("f4")  # kilograms, computed at reset from density and shape
    inertia: Array = column("f4")  # kilogram square metres about the centre, computed at reset
    may_collide: Array = column("u1", high=1)  # 1: may touch something in this tick
    max_travel: Array = column("f4")  # metres it may travel in this tick


class Push(Component):
    """The impulse of motors in this tick, in the world frame, which the physics applies."""

    x: Array = column("f4")  # newton-seconds of a tick, spread evenly over its substeps
    y: Array = column("f4")
    turn: Array = column("f4")  # newton-metre-seconds of a tick, spread evenly over its substeps


class Spawned(Component):
    """An entity that gets a cell of the spawn grid at reset."""

    requires = (Body,)
    cell: Array = column("i4", fill=-1)


class Floor(Singleton):
    """The rectangle of the plane that is the room, centred on the origin."""

    size: Array = column("f4", "floor sides")  # metres: width (first) and height (last), or the side of a square


class Fault(Singleton):
    """An unrecoverable error in this world, at which the environment raises an exception."""

    physics: Array = column("u1")  # 1: a body had a number that Box2D cannot use (NaN, too large, no size, no mass)


def room_sides(layout: Layout) -> tuple[float, float] | None:
    """Return width and height of the room, metres; None without a room."""
    if Floor not in layout.singletons:
        return None
    sides = np.ravel(layout.singletons[Floor].fills["size"])
    return float(sides[0]), float(sides[-1])


def half_room(layout: Layout) -> float:
    """Return the distance from the middle of the room to the farther walls, metres: the scale of positions (or 1)."""
    return max(room_sides(layout) or (2.0, 2.0)) / 2


@kernel
def face(body: Any, e: int, angle: Any) -> None:
    """Turn body `e` to an angle: radians, counter-clockwise from +x."""
    body.angle[e], body.cosine[e], body.sine[e] = angle, np.cos(angle), np.sin(angle)


PLACE = (Field("x", "m", scale=half_room), Field("y", "m", scale=half_room))  # fields of a position


@kernel
def inverse(quantity: Any) -> Any:
    """Return 1 / mass or 1 / inertia, float32; 0 for a body without mass, which cannot be moved."""
    return ONE / quantity if quantity > 0 else ZERO
