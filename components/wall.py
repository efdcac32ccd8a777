"""Walls inside the room: static blocks, and data to keep bodies out of them."""

import numpy as np

from outlast.ecs import Array, Component, Singleton, column, kernel
from outlast.ecs.kernels.random import stream_number

NAME = "inner_wall"  # the archetype's name
KIND, SHIFT = np.int64(stream_number(NAME) >> 33), np.int64(32)  # upper bits of its entities' identities, from bit 32


class Wall(Component):
    """A static block inside the room, while alive: a rectangle that collides, blocks sight and stops strikes.

    Its columns are computed at reset. A system that turns or resizes a block later must write them, too: they keep
    bodies and strikes out of the block.
    """

    half_x: Array = column("f4")  # metres, half the sides of the upright rectangle around it
    half_y: Array = column("f4")


class Before(Singleton):
    """Places of bodies before they moved in this tick."""

    x: Array = column("f4", "rows")  # metres
    y: Array = column("f4", "rows")


class StartAreas(Singleton, packed=False):
    """The areas in which bodies that spawn start: rectangles, written and read by the mechanic that sets up walls.

    They are used in resets only, and are not part of the state.
    """

    # x, y, width, height, angle, and the use (systems.geometry.places); width 0: none; the last one is the room
    area: Array = column("f4", "start areas", 6)


class Unplaced(Singleton):
    """The number of bodies without a free place in the room at reset; if it is not 0, environments raise an error."""

    bodies: Array = column("i4")  # their number


@kernel
def is_inner_wall(entities: Array, e: int) -> bool:
    """Return whether row `e` is a block; also for scenarios without blocks."""
    return bool(entities.identity[e] >> SHIFT == KIND)
