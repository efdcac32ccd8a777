"""How far from the middle of the room things can be, along either axis: for the bounds of observations."""

import math

from outlast.ecs import Layout

ROUNDED = 1 + 2.0**-22  # sums and means of a few float32 are at most this many times as large as exact ones


def moved(layout: Layout) -> float:
    """Metres to the centre of a body that spawns or moves: walls keep it inside. Infinite without walls."""
    room = layout.numbers("room")
    half: float = room["size"] / 2 if room.get("walls") else math.inf
    return half


def laid(layout: Layout) -> float:
    """Metres to the centre of an item: where it spawned, or where an agent laid it down, which can be in a wall."""
    farthest: float = max(layout.numbers("drop").get("radius", 0), layout.numbers("drop_last").get("offset", 0))
    return (moved(layout) + farthest) * ROUNDED
