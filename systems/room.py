"""The room: a square floor, and four walls around it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Floor, Phase, Shape, Solid
from outlast.ecs import Archetype, Module, Rows, Singleton, Write, number


@dataclass(frozen=True)
class Room(Module):
    """Square region centred on the origin; walls stand astride its edges (reference rules, section 1)."""

    size: float = number(25.0, low=1)  # metres, side
    walls: bool = number(True)
    thickness: float = number(0.01, low=0.003, high=0.5)  # of a wall, as a share of the side

    def archetypes(self) -> Iterable[Archetype]:
        if not self.walls:
            return []
        far, long, thin = self.size / 2, self.size / 2, self.size * self.thickness / 2
        body = Body(x=[far, -far, 0, 0], y=[0, 0, far, -far])
        shape = Shape(half_width=[thin, thin, long, long], half_height=[long, long, thin, thin])
        return [Archetype("wall", (body, shape, Solid()), 4)]

    def singletons(self) -> Iterable[Singleton]:
        return [Floor(size=self.size)]


@Room.system(Phase.SPAWN)
def measure(shape: Write[Shape], bodies: Rows[Shape]) -> None:
    """The circle around each body, by which most rays and contacts are ruled out."""
    for e in bodies:
        x, y = shape.half_width[e], shape.half_height[e]
        shape.bound[e] = max(shape.radius[e], np.float32(np.sqrt(x * x + y * y)))
