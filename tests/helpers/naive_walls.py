"""Naive forms for walls inside of the room: distances, overlaps, and which floor is connected; float64."""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from outlast.components import Body, Floor, Shape, Solid, Spawned, Wall
from outlast.ecs import Entity, Worlds
from outlast.systems import Walls
from tests.reference.random_numbers import keyed

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


def cell_walls(mechanic: Any, sides: Any, key: tuple[int, int, int]) -> list[tuple[float, ...]]:
    """The blocks of a Maze or Rooms by numpy's random numbers: x, y, half width and half height.

    sides: of the room, metres. key: seed, world and episode.
    """

    def word(index: int) -> int:
        return keyed(key, 0, "inner_walls.build", index)[0]

    columns, rows, half, edges = mechanic.columns, mechanic.rows, mechanic.thickness / 2, 2 * 32 * 31  # at most
    rooms, found = mechanic.name == "rooms", list[tuple[float, ...]]()
    pairs = [((i, j), (i + 1, j)) for j in range(rows) for i in range(columns - 1)]
    pairs += [((i, j), (i, j + 1)) for j in range(rows - 1) for i in range(columns)]
    part, order, passable = {cell: {cell} for pair in pairs for cell in pair}, [*range(len(pairs))], set[int]()
    for n in range(len(pairs)):
        pick = n + (word(n) * (len(pairs) - n) >> 64)
        order[n], order[pick] = order[pick], order[n]
        k = order[n]
        one, two = (part[cell] for cell in pairs[k])
        if one is not two:
            one |= two
            part |= dict.fromkeys(two, one)
            passable.add(k)
        elif (word(edges + k) >> 40) / 2**24 < (mechanic.doors if rooms else mechanic.loops):
            passable.add(k)
    for k, ((i, j), (beside, _)) in enumerate(pairs):
        axes = (sides[0], columns, i), (sides[-1], rows, j)
        (side, count, line), (end, cells, cell) = axes if beside > i else axes[::-1]
        start, length = cell * end / cells, end / cells
        spans = [(max(0, start - half), min(end, start + length + half))]
        if k in passable and rooms:
            spare = (length - mechanic.door) / 8
            opening = start + spare + (word(2 * edges + k) >> 40) / 2**24 * (length - mechanic.door - 2 * spare)
            spans = [(spans[0][0], opening), (opening + mechanic.door, spans[0][1])]
        for low, high in spans if rooms or k not in passable else ():
            across, along = (line + 1) * side / count - side / 2, (low + high - end) / 2
            far = (high - low) / 2
            found.append((across, along, half, far) if beside > i else (along, across, far, half))
    return found


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
