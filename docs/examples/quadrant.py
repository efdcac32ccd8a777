"""A quadrant: a corner of the room behind two walls, each with a door, drawn anew for every episode."""

from dataclasses import dataclass
from typing import ClassVar

from yard import yard

from outlast.components import Body, Floor, Phase, Shape, Solid, Spawned, StartAreas, Wall
from outlast.ecs import Archetype, Component, Entity, Module, Random, Read, Rows, Write, number, ref
from outlast.ecs.kernels.random import uniform
from outlast.systems.geometry.mazes import place_block
from outlast.systems.geometry.places import kind_use, set_area
from outlast.systems.inner_walls import InnerWalls

THIN = 0.1  # metres: half the thickness of a wall
CRATES, AGENTS = kind_use("crate"), kind_use("agent")


class Crate(Component):
    """What starts in the quadrant."""


@dataclass(frozen=True)
class Crates(Module):
    """Movable boxes; there may be none."""

    count: int = number(2, low=0, high=20, about="number of crates")

    def archetypes(self):
        """What has Spawned gets a free place."""
        parts = Body(), Shape(half_width=0.4, half_height=0.3), Solid(dynamic=1, density=0.5), Spawned(), Crate()
        return [Archetype("crate", parts, ref("count"))]


@dataclass(frozen=True)
class Quadrant(InnerWalls):
    """The lower left part of the floor is closed off, but for two doors. Crates start in it, agents outside."""

    draws_level: ClassVar[bool] = True

    share: float = number(0.5, low=0.3, high=0.6, about="its side over that of the room")
    door: float = number(1.6, above=0, high=10, unit="metres", about="width of a door")

    def most_blocks(self):
        """Two for each wall, as there is a door in it."""
        return 4

    def most_areas(self):
        """One for crates, and two for agents."""
        return 3

    def check(self, layout):
        """A door that nobody fits through is refused."""
        self.check_passage(layout, "a door", self.door, "a larger quadrant.door")


@Quadrant.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    areas: Write[StartAreas],
    floor: Read[Floor],
    walls: Rows[Wall],
    share: float,
    door: float,
    key: Random,
) -> None:
    """Set up each wall in two parts, left and right of its door, and write the start areas."""
    side = floor.size[0]
    low, inner = -0.5 * side, share * side
    line, rest = low + inner, side - inner  # where the walls stand, and how wide the floor is beyond them
    for k in range(2):
        start = THIN + uniform(key, k) * (inner - door - 2 * THIN)
        for part in range(2):
            begin, end = (low, low + start) if part == 0 else (low + start + door, line)
            middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
            if k == 0:
                place_block(body, shape, entities, walls[part], middle, line, half, THIN)
            else:
                place_block(body, shape, entities, walls[2 + part], line, middle, THIN, half)
    set_area(areas, 0, CRATES, low + 0.5 * inner, low + 0.5 * inner, inner, inner, 0.0)
    set_area(areas, 1, AGENTS, line + 0.5 * rest, 0.0, rest, side, 0.0)
    set_area(areas, 2, AGENTS, low + 0.5 * inner, line + 0.5 * rest, inner, rest, 0.0)


QUADRANT = yard("quadrant", Quadrant(), Crates())
