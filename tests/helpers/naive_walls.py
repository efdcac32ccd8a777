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


def rim(block: Block, step: float = 0.02) -> Array:
    """Points all around a body and its middle, complex."""
    if block.radius:
        points = block.radius * np.exp(1j * np.arange(0, 2 * math.pi, step / block.radius))
    else:
        a, b = block.half_width, block.half_height
        along = np.linspace(-1, 1, max(2, math.ceil(2 * max(a, b) / step)))
        points = np.concatenate([a * along + 1j * b, a * along - 1j * b, a + 1j * b * along, -a + 1j * b * along])
    return np.append(points, 0) * complex(math.cos(block.angle), math.sin(block.angle)) + complex(block.x, block.y)


def overlap(one: Block, two: Block) -> bool:
    """Whether two bodies overlap: a point on the rim of one, or its middle, is in the other."""
    return any(
        bool((signed_distance(a, (points := rim(b)).real, points.imag) < 0).any()) for a, b in ((one, two), (two, one))
    )


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


def depth_in_walls(worlds: Worlds) -> tuple[Array, Array]:
    """How deep the centres of moving bodies, and their rims, are in walls: metres (worlds,), the deepest of each world.

    The walls of the room do not count. The rim of a rectangle is taken to be the circle inside of it.
    """
    body, shape, alive, solid = worlds[Body], worlds[Shape], worlds[Entity].alive, worlds[Solid]
    moving = [e for e in worlds.layout.rows(Solid) if solid.dynamic[0, e]]
    centre, edge = np.full(worlds.count, -np.inf), np.full(worlds.count, -np.inf)
    for o in worlds.layout.rows(Wall):
        turn = np.exp(-1j * body.angle[:, o].astype(float))
        for e in moving:
            local = (body.x[:, e] - body.x[:, o] + 1j * (body.y[:, e] - body.y[:, o])) * turn
            beside = abs(local.real) - shape.half_width[:, o]
            above = abs(local.imag) - shape.half_height[:, o]
            gap = np.where((beside > 0) & (above > 0), np.hypot(beside, above), np.maximum(beside, above))
            there = (alive[:, o] & alive[:, e]) != 0
            own = np.maximum(shape.radius[:, e], np.minimum(shape.half_width[:, e], shape.half_height[:, e]))
            centre = np.maximum(centre, np.where(there, -gap, -np.inf))
            edge = np.maximum(edge, np.where(there, own - gap, -np.inf))
    return centre, edge
