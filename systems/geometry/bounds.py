"""How far from the middle of the room a position can be, along either axis: for the bounds of observations."""

import math

from outlast.ecs import Layout

ROUNDING = 1 + 2.0**-22  # sums and means of a few float32 are at most this many times as large as exact ones


def farthest_body(layout: Layout) -> float:
    """Metres to the centre of a body that spawns or moves: walls keep it inside. Infinite without walls."""
    room = layout.numbers("room")
    half: float = room["size"] / 2 if room.get("walls") else math.inf
    return half


def farthest_item(layout: Layout) -> float:
    """Metres to the centre of an item: where it spawned, or where an agent dropped it, which can be in a wall."""
    dropped: float = max(layout.numbers("death_drop").get("radius", 0), layout.numbers("drop_last").get("offset", 0))
    return (farthest_body(layout) + dropped) * ROUNDING
