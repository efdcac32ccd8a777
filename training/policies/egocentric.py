"""What agents observe, as seen from where they stand and in the direction that they look.

An agent's actions are in its own frame (ahead, to the left, turn), but observations are in the room's, with angles that
grow with every turn. So a network would have to learn to subtract and to rotate before it could walk up to anything.
Here is what has to be turned in the rows of each key; the packer does it.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.ecs.kernels.jit import kernel, loader, storer

from ..base.errors import TrainingError
from ..base.observation_layout import OWN, ObservationLayout

Array = np.ndarray[Any, Any]
ANGLE = "angle"
VECTORS = {  # the fields of a vector: the first field of the agent's own vector that is subtracted from it
    ("x", "y"): "x",
    ("next_x", "next_y"): "x",
    ("vx", "vy"): "vx",
}
ME = ("x", "y", "vx", "vy", ANGLE)
MOVED = {"x": 2, "vx": 0, ANGLE: 0}  # of itself, an agent observes where the room's middle is, and its velocity
TURN = 5  # numbers of a turn: columns of x and y (-1: an angle), those of the origin, and how often it is subtracted
word, read, write = loader("int64"), loader("float32"), storer("float32")


def turns(layout: ObservationLayout) -> list[Array]:
    """Return how rows come into the frame of the agent that observes: its place is the origin, it looks along x.

    Places become relative to the agent's place, velocities to its velocity. Angles of others become relative to its
    own, and all angles are brought into the range of -pi to pi. Returns int64 (turns, TURN) for an agent's own numbers,
    and then for each kind. Raises TrainingError if the layout lacks the agent's own place, velocity or angle.
    """
    columns = layout.field_columns()
    if not columns[OWN].keys() >= {*ME}:
        raise TrainingError(f"preset fast needs the fields {', '.join(ME)} of '{OWN}'; take another preset")
    own = [each for key in layout.alone for each in _turns(columns[key], columns[OWN], MOVED if key == OWN else {})]
    kinds = [_turns(columns[kind.key], columns[OWN], {}) for kind in layout.kinds]
    return [np.array(each, np.int64).reshape(-1, TURN) for each in (own, *kinds)]


def _turns(columns: Mapping[str, int], me: Mapping[str, int], moved: Mapping[str, int]) -> list[tuple[int, ...]]:
    found: list[tuple[int, ...]] = [
        (columns[x], columns[y], me[origin], me[origin.replace("x", "y")], moved.get(x, 1))
        for (x, y), origin in VECTORS.items()
        if x in columns and y in columns
    ]
    angles = [(columns[ANGLE], -1, me[ANGLE], 0, moved.get(ANGLE, 1))] if ANGLE in columns else []
    return found + angles


@kernel
def turn(row: int, me: int, angle: int, turned: int, count: int) -> None:
    """Turn a row in place. row, me: Addresses of float32 numbers, those of the row and the agent's own as observed.

    angle: Column of the agent's angle. turned: Address of the turns. count: How many these are.
    """
    if count == 0:
        return
    ahead = read(me + 4 * angle)
    cosine, sine = np.float32(math.cos(ahead)), np.float32(math.sin(ahead))
    for t in range(turned, turned + 8 * TURN * count, 8 * TURN):
        x, y, factor = row + 4 * word(t), row + 4 * word(t + 8), np.float32(word(t + 32))
        dx = read(x) - read(me + 4 * word(t + 16)) * factor
        if word(t + 8) < 0:
            around = np.float32(2 * math.pi)
            shifted = dx + np.float32(math.pi)
            write(x, shifted - around * np.float32(math.floor(shifted / around)) - np.float32(math.pi))
        else:
            dy = read(y) - read(me + 4 * word(t + 24)) * factor
            write(x, cosine * dx + sine * dy)
            write(y, cosine * dy - sine * dx)
