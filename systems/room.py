"""The room: a square floor, and four walls around it."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Floor, Phase, Shape, Solid
from outlast.ecs import Archetype, Bitset, Entity, Module, Read, Rows, Singleton, System, Write, kernel, number
from outlast.ecs.simd import SIMD_WIDTH, load, load_flags, to_bits

from .geometry.blocks import alive_bits, first_row
from .geometry.broad_phase import outer_radius

HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)


@dataclass(frozen=True)
class Room(Module):
    """Square region centred on the origin; walls stand astride its edges (reference rules, section 1)."""

    size: float = number(25.0, low=1, high=100_000)  # metres, side
    walls: bool = number(True)
    thickness: float = number(0.01, low=0.003, high=0.5)  # of a wall, as a share of the side

    def systems(self) -> Iterable[System]:
        return [system for system in super().systems() if self.walls or system.name != "keep_inside"]

    def archetypes(self) -> Iterable[Archetype]:
        if not self.walls:
            return []
        far, long, thin = self.size / 2, self.size / 2, self.size * self.thickness / 2
        body = Body(x=[far, -far, 0, 0], y=[0, 0, far, -far])
        shape = Shape(half_width=[thin, thin, long, long], half_height=[long, long, thin, thin])
        return [Archetype("wall", (body, shape, Solid()), 4, order=50)]

    def singletons(self) -> Iterable[Singleton]:
        return [Floor(size=self.size)]


@Room.system(Phase.SPAWN)
def compute_bounds(shape: Write[Shape], bodies: Rows[Shape]) -> None:
    """The circle around each body, whose radius is the room that it is left beside a wall."""
    for e in bodies:
        shape.bound[e] = outer_radius(shape, e)


@Room.system(Phase.MOVE, after=Body)
def keep_inside(
    body: Write[Body],
    solid: Read[Solid],
    shape: Read[Shape],
    floor: Read[Floor],
    entities: Read[Entity],
    solids: Bitset[Solid],
    thickness: float,
) -> None:
    """A body that was pushed through a wall, as by a box that reaches into it, is put back inside, at rest."""
    middle = HALF * floor.size[0]
    inside = middle * (ONE - thickness)
    for b in range(solids.size):
        beyond = (abs(load(body.x, SIMD_WIDTH * b)) > middle) | (abs(load(body.y, SIMD_WIDTH * b)) > middle)
        pending = to_bits(beyond & load_flags(solid.dynamic, SIMD_WIDTH * b)) & alive_bits(entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            room = max(inside - shape.bound[e], ZERO)
            body.x[e], body.vx[e] = clamp(body.x[e], body.vx[e], middle, room)
            body.y[e], body.vy[e] = clamp(body.y[e], body.vy[e], middle, room)


@kernel
def clamp(position: Any, speed: Any, middle: Any, room: Any) -> Any:
    """Position and speed along one axis of a body whose centre may be beyond the middle of a wall."""
    if position > middle:
        return room, min(speed, ZERO)
    if position < -middle:
        return -room, max(speed, ZERO)
    return position, speed
