"""Bounds of positions from the middle of the room, along x and y, and checks of sizes that fit into it."""

import math
from typing import Any

import numpy as np

from outlast.components.body import room_sides
from outlast.ecs import Component, Layout, NumberError, kernel

ZERO = np.float32(0)
ROUNDING = 1 + 2.0**-22  # sums and means of a few float32 exceed exact ones by at most this factor


def farthest_body(layout: Layout) -> tuple[float, float]:
    """Return the maximum distance of a spawning or moving body, metres: walls keep it inside; else infinite."""
    sides = room_sides(layout) if layout.numbers("room").get("walls") else None
    return (sides[0] / 2, sides[1] / 2) if sides else (math.inf, math.inf)


def farthest_item(layout: Layout) -> tuple[float, float]:
    """Return the maximum distance of an item, metres: where it spawned, or was dropped, perhaps inside a wall."""
    dropped: float = max(layout.numbers("death_drop").get("radius", 0), layout.numbers("drop_last").get("offset", 0))
    x, y = farthest_body(layout)
    return (x + dropped) * ROUNDING, (y + dropped) * ROUNDING


def ends(far: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Return bounds of the fields x and y."""
    return {"x": (-far[0], far[0]), "y": (-far[1], far[1])}


def floor_sides(layout: Layout) -> tuple[float, float]:
    """Return width and height of the floor, metres; infinite without a floor."""
    return room_sides(layout) or (math.inf, math.inf)


def check_fits(layout: Layout, name: str, value: float, width: float) -> None:
    """Raise NumberError if `width`, metres, exceeds the room, where the number `name` is `value`."""
    if width > (size := min(floor_sides(layout))):
        most = value / width * size
        raise NumberError(f"{name} = {value:g} does not fit into a room of side {size:g}: at most {most:g} is possible")


def count_kinds(layout: Layout, component: type[Component]) -> str:
    """Return the numbers of entities with a component by kind, in words: "2 agent, 4 wall"."""
    kinds = [kind for kind in layout.archetypes.values() if any(isinstance(part, component) for part in kind.parts)]
    return ", ".join(f"{kind.count} {kind.name}" for kind in kinds)


@kernel
def clamp(position: Any, speed: Any, middle: Any, room: Any) -> Any:
    """Correct position and speed along one axis of a body whose centre may be beyond a line, as the middle of a wall.

    Beyond it, the position becomes `room`, and only speed towards the centre is kept. middle, room: distances from the
    centre of the room.
    """
    if position > middle:
        return room, min(speed, ZERO)
    if position < -middle:
        return -room, max(speed, ZERO)
    return position, speed
