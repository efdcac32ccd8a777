"""Naive forms for walls inside of the room: distances, overlaps, and which floor is connected; float64."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from outlast.components import Body, Floor, Shape, Solid, Spawned, Wall
from outlast.ecs import Entity, Worlds
from outlast.systems import Walls

Array = np.ndarray[Any, Any]


def level(*rectangles: tuple[float, ...]) -> Walls:
    """Walls from rectangles of six numbers."""
    return Walls(layout=tuple(itertools.chain(*rectangles)))


class Block(NamedTuple):
    """A body: a rectangle, or a disc if it has a radius."""

    x: float
    y: float
    angle: float
    half_width: float
    half_height: float
    radius: float = 0.0


def blocks(worlds: Worlds, w: int, *components: type[Any]) -> list[Block]:
    """The bodies that are there in world `w` and have these components; walls, if none are named."""
    body, shape, alive = worlds[Body], worlds[Shape], worlds[Entity].alive[w]
    columns = (body.x, body.y, body.angle, shape.half_width, shape.half_height, shape.radius)
    rows = [e for e in worlds.layout.rows(*(components or (Wall,))) if alive[e]]
    return [Block(*(float(column[w, e]) for column in columns)) for e in rows]


def obstacles(worlds: Worlds, w: int) -> list[Block]:
    """What stays in its place for the whole episode: the room's own walls, and those inside."""
    spawned = {*blocks(worlds, w, Spawned)}
    return [block for block in blocks(worlds, w, Solid) if block not in spawned]


def signed_distance(block: Block, x: Any, y: Any) -> Any:
    """Metres from points to the rim of a body; below 0 inside."""
    turn = complex(math.cos(block.angle), -math.sin(block.angle))
    local = ((np.asarray(x) - block.x) + 1j * (np.asarray(y) - block.y)) * turn
    if block.radius:
        return abs(local) - block.radius
    beside, above = abs(local.real) - block.half_width, abs(local.imag) - block.half_height
    return np.where((beside > 0) & (above > 0), np.hypot(beside, above), np.maximum(beside, above))


def free_parts(worlds: Worlds, w: int, radius: float, step: float = 0.05) -> list[int]:
    """How many points of a lattice are in each connected part of the floor that a disc can roam, the largest first."""
    sides = worlds[Floor].size[w]
    xs, ys = (np.arange(-side / 2, side / 2, step) for side in (sides[0], sides[-1]))
    free = np.ones((len(xs), len(ys)), bool)
    for block in obstacles(worlds, w):
        free &= signed_distance(block, xs[:, None], ys[None, :]) >= radius
    parts = []
    while free.any():
        part = np.zeros_like(free)
        part[np.unravel_index(free.argmax(), free.shape)] = True
        size = 0
        while (count := int(part.sum())) > size:
            size = count
            part = _swept(_swept(part, free).T, free.T).T
        parts.append(size)
        free &= ~part
    return sorted(parts, reverse=True)


def _swept(part: Array, free: Array) -> Array:
    """All points of those runs of free points, along rows, in which some point belongs to the part."""
    starts = np.diff(free, axis=1, prepend=False) & free
    line = np.cumsum(starts.ravel()).reshape(free.shape)  # the number of each point's run, from 1 on
    chosen = np.zeros(int(line.max()) + 1, bool)
    chosen[line[part]] = True
    swept: Array = chosen[line] & free
    return swept
