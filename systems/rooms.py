"""Rooms with doors: the floor is divided into a grid of rooms, with doors drawn anew for each episode."""

from dataclasses import dataclass
from typing import ClassVar

from outlast.components import Body, Floor, Phase, Shape, Wall
from outlast.components.limits import FAR
from outlast.ecs import Entity, Layout, NumberError, Random, Read, Rows, Scratch, Write, number

from .geometry.mazes import MOST, open_edges, place_edges
from .inner_walls import InnerWalls


@dataclass(frozen=True)
class Rooms(InnerWalls):
    """Rooms that are all connected: a random spanning tree of doors, and additional doors.

    A wall with a door is two blocks, one without a door is one. The position of a door in its wall is drawn, too: at
    least an eighth of the rest of the wall is on either side. Doors are wide enough for the widest agent.
    """

    draws_level: ClassVar[bool] = True

    columns: int = number(3, low=1, high=MOST, unit="rooms", about="rooms from left to right")
    rows: int = number(3, low=1, high=MOST, unit="rooms", about="rooms from bottom to top")
    doors: float = number(0.5, low=0, high=1, about="probability of a door between two rooms that are connected anyway")
    door: float = number(1.6, above=0, high=FAR, unit="metres", about="width of a door")
    thickness: float = number(0.4, low=0.004, high=FAR, unit="metres", about="thickness of a wall")
    blocks: int = number(
        0, low=0, high=450, about="room for this many walls, where the rooms vary; 0: as many as these rooms need"
    )

    def most_blocks(self) -> int:
        return self.blocks or max(1, self.needed())

    def needed(self) -> int:
        """Return the number of blocks if every wall has a door."""
        return 2 * ((self.columns - 1) * self.rows + self.columns * (self.rows - 1))

    def check(self, layout: Layout) -> None:
        if self.needed() > self.most_blocks():
            raise NumberError(
                f"rooms.blocks = {self.blocks}: {self.columns} x {self.rows} rooms need {self.needed()}; take more, "
                "or 0"
            )
        self.check_passage(layout, "a door", self.door, "a larger rooms.door")
        whole, sides = self.whole(layout), self.inside(layout)
        for side, inner, count, what in zip(whole, sides, (self.columns, self.rows), ("columns", "rows"), strict=True):
            stays = (side / count - self.door) / 8
            thick = max(self.thickness, side - inner) / 2
            if stays < thick:
                raise NumberError(
                    f"rooms.door = {self.door:g}: a wall of a room is {side / count:.3g} m long, but beside the door "
                    f"{max(0, 8 * thick):.3g} m must stay; take fewer rooms.{what}, a smaller door or less "
                    "rooms.thickness"
                )


@Rooms.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    floor: Read[Floor],
    walls: Rows[Wall],
    memory: Scratch,
    columns: int,
    rows: int,
    doors: float,
    door: float,
    thickness: float,
    key: Random,
) -> None:
    """Draw the doors and their positions, and set up the remaining parts of the walls."""
    open_edges(memory, columns, rows, doors, key)
    sides = (floor.size[0], floor.size[floor.size.size - 1])
    place_edges((body, shape, entities), walls, memory, columns, rows, sides, thickness, door, key)
