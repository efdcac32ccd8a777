"""The quadrant: a corner of the room behind two walls with doors, drawn anew for every episode."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from outlast.components import Body, Floor, Phase, Shape, StartAreas, Wall
from outlast.components.hide_and_seek import HIDERS, SEEKERS, Doors
from outlast.components.limits import FAR
from outlast.ecs import Entity, Layout, NumberError, Random, Read, Rows, Singleton, Write, number
from outlast.ecs.kernels.random import uniform
from outlast.systems.geometry.mazes import place_span
from outlast.systems.geometry.places import kind_use, set_area
from outlast.systems.inner_walls import InnerWalls

WALLS, PARTS = 2, 2  # the walls of the quadrant, and the parts into which a door divides one
CRATE, PLANK = kind_use("crate"), kind_use("plank")
CLOSED = 2 * WALLS  # index of the draw of the wall without a door
HALF = np.float32(0.5)


@dataclass(frozen=True)
class Quadrant(InnerWalls):
    """The lower right corner of the floor is closed off by two walls, each with a door (hide_and_seek.py, walls.py).

    Crates and planks start in it, seekers outside of it, hiders and ramps anywhere.
    """

    draws_level: ClassVar[bool] = True

    share: float = number(0.5, low=0.2, high=0.8, about="side of the quadrant over that of the room")
    door: float = number(0.5, above=0, high=FAR, unit="metres", about="width of a door")
    thickness: float = number(0.1, low=0.004, high=FAR, unit="metres", about="thickness of a wall")
    closed: float = number(0.5, low=0, high=1, about="probability that one of the two walls has no door")
    hiders_inside: bool = number(False, about="hiders start in the quadrant")

    def most_blocks(self) -> int:
        return WALLS * PARTS

    def most_areas(self) -> int:
        return 5

    def dims(self) -> dict[str, int | str]:
        return {**super().dims(), "doors": WALLS}

    def singletons(self) -> Iterable[Singleton]:
        return [*super().singletons(), Doors()]

    def check(self, layout: Layout) -> None:
        self.check_passage(layout, "a door", self.door, "a larger quadrant.door")
        least = min(self.whole(layout)) * min(self.share, 1 - self.share)
        if least < (needed := self.door + 3 * self.thickness):
            raise NumberError(
                f"quadrant.door = {self.door:g}: a wall would be {least:.3g} m long, and {needed:.3g} m are needed; "
                "take a smaller door, or a share nearer to 0.5"
            )


@Quadrant.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    areas: Write[StartAreas],
    doors: Write[Doors],
    floor: Read[Floor],
    walls: Rows[Wall],
    share: float,
    door: float,
    thickness: float,
    closed: float,
    hiders_inside: bool,
    key: Random,
) -> None:
    """Set up the walls, and write the start areas."""
    width, height = floor.size[0], floor.size[floor.size.size - 1]
    wide, high = share * width, share * height
    left, top = HALF * width - wide, high - HALF * height  # where the walls stand
    without = -1 if uniform(key, CLOSED) >= closed else int(uniform(key, CLOSED + 1) * np.float32(WALLS))
    for k in range(WALLS):
        upright = k == 0
        first, last = (-HALF * height, top) if upright else (left, HALF * width)
        line, spare = left if upright else top, thickness + thickness
        begin = first + spare + uniform(key, k) * (last - first - door - spare - spare)
        doors.open[k] = k != without
        doors.x[k], doors.y[k] = (line, begin + HALF * door) if upright else (begin + HALF * door, line)
        end = begin + door
        if k == without:
            begin = end = last
        place_span((body, shape, entities), walls[PARTS * k], line, first, begin, HALF * thickness, upright)
        if end < last:
            place_span((body, shape, entities), walls[PARTS * k + 1], line, end, last, HALF * thickness, upright)
    x, y = left + HALF * wide, top - HALF * high
    for k in range(2):
        set_area(areas, k, CRATE if k == 0 else PLANK, x, y, wide, high, 0)
    set_area(areas, 2, SEEKERS + 1, HALF * (left - HALF * width), 0, width - wide, height, 0)
    set_area(areas, 3, SEEKERS + 1, x, HALF * (top + HALF * height), wide, height - high, 0)
    set_area(areas, 4, HIDERS + 1, x, y, wide if hiders_inside else 0, high, 0)
