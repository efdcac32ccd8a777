"""How far from the middle of the room a position can be, along either axis, and what fits into the room."""

import math

from outlast.components import Floor
from outlast.ecs import Layout, NumberError

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


def room_size(layout: Layout) -> float:
    """Metres, side of the floor; infinite if there is none."""
    size: float = layout.singletons[Floor].fills["size"] if Floor in layout.singletons else math.inf
    return size


def check_fits(layout: Layout, name: str, value: float, width: float) -> None:
    """NumberError if something that is `width` metres wide, because of the number `name`, is wider than the room."""
    if width > (size := room_size(layout)):
        most = value / width * size
        raise NumberError(f"{name} = {value:g} does not fit into a room of side {size:g}: at most {most:g} is possible")
