"""The room: a square or rectangular floor, and four walls around it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Floor, Phase, Shape, Solid
from outlast.components.limits import FAR
from outlast.ecs import (
    Archetype,
    Bitset,
    Entity,
    Module,
    NumberError,
    Read,
    Rows,
    Singleton,
    System,
    Write,
    number,
    ref,
)
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, to_bits

from .geometry.blocks import alive_bits, first_row
from .geometry.bounds import clamp
from .geometry.broad_phase import outer_radius

HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)


@dataclass(frozen=True)
class Room(Module):
    """A floor centred on the origin, with walls astride its edges (reference rules, section 1).

    It is a square of side `size`; with width or height it is a rectangle, and `size` replaces the one that is 0.
    """

    size: float = number(25.0, low=1, high=FAR, unit="metres", about="side of the square")
    walls: bool = number(True, about="there are walls around the room")
    thickness: float = number(
        0.01, low=0.003, high=0.5, unit="of the distance to the opposite wall", about="thickness of a wall"
    )
    width: float = number(0.0, low=0, high=FAR, unit="metres", about="size along x; 0: room_size")
    height: float = number(0.0, low=0, high=FAR, unit="metres", about="size along y; 0: room_size")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width", "height"):
            if 0 < (side := getattr(self, name)) < 1:
                raise NumberError(f"room.{name} = {side:g}: at least 1 m is needed, or 0 for room.size")
        if self.width and self.height and self.size != type(self).size:
            raise NumberError(
                f"room.size = {self.size:g} has no effect beside room.width and room.height; leave it at "
                f"{type(self).size:g}, or set one of them to 0"
            )

    def systems(self) -> Iterable[System]:
        return [system for system in super().systems() if self.walls or system.name != "keep_inside"]

    def archetypes(self) -> Iterable[Archetype]:
        if not self.walls:
            return []
        (x, y), thin = (side / 2 for side in self.sides()), self.thickness
        body = Body(x=[x, -x, 0, 0], y=[0, 0, y, -y])
        shape = Shape(half_width=[x * thin, x * thin, x, x], half_height=[y, y, y * thin, y * thin])
        return [Archetype("wall", (body, shape, Solid()), 4, order=50)]

    def singletons(self) -> Iterable[Singleton]:
        return [Floor(size=ref("size") if self.is_square() else self.sides())]

    def dims(self) -> dict[str, int | str]:
        return {"floor sides": 1 if self.is_square() else 2}

    def sides(self) -> tuple[float, float]:
        """Return width and height, metres."""
        return self.width or self.size, self.height or self.size

    def is_square(self) -> bool:
        """Return whether a single number is its size."""
        return self.width == self.height == 0


@Room.system(Phase.SPAWN)
def compute_bounds(shape: Write[Shape], bodies: Rows[Shape]) -> None:
    """Compute the radius of the circle around each body, which decides its distance to walls."""
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
    """Put back bodies that were pushed through a wall, as by an overlapping box, without speed in that direction."""
    middle_x, middle_y = HALF * floor.size[0], HALF * floor.size[floor.size.size - 1]
    inside_x, inside_y = middle_x * (ONE - thickness), middle_y * (ONE - thickness)
    for b in range(solids.size):
        beyond = (abs(load(body.x, SIMD_WIDTH * b)) > middle_x) | (abs(load(body.y, SIMD_WIDTH * b)) > middle_y)
        pending = to_bits(beyond & load_flags(solid.dynamic, SIMD_WIDTH * b)) & alive_bits(entities, solids, b)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            room_x, room_y = max(inside_x - shape.bound[e], ZERO), max(inside_y - shape.bound[e], ZERO)
            body.x[e], body.vx[e] = clamp(body.x[e], body.vx[e], middle_x, room_x)
            body.y[e], body.vy[e] = clamp(body.y[e], body.vy[e], middle_y, room_y)
