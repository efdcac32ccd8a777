"""Walls inside of the room: static blocks, and what keeps bodies out of them."""

from outlast.ecs import Array, Component, Singleton, column


class Wall(Component):
    """A static block inside of the room, while alive: a rectangle that collides, hides and stops blows."""

    index: Array = column("i4")  # its number among the blocks


class Before(Singleton):
    """Where every body was before it moved in this tick."""

    x: Array = column("f4", "rows")  # metres
    y: Array = column("f4", "rows")


class Unplaced(Singleton):
    """Bodies for which the room had no free place at reset; an environment that finds any raises."""

    bodies: Array = column("i4")
