"""A maze: corridors between walls along the lines of a grid, drawn anew for each episode."""

from dataclasses import dataclass
from typing import ClassVar

from outlast.components import Body, Floor, Phase, Shape, Wall
from outlast.components.limits import FAR
from outlast.ecs import Entity, Layout, NumberError, Random, Read, Rows, Scratch, Write, number

from .geometry.mazes import MOST, open_edges, place_edges
from .inner_walls import InnerWalls


@dataclass(frozen=True)
class Maze(InnerWalls):
    """Cells that are all connected: a random spanning tree, with additional openings that make loops.

    Every wall between two cells is one block or open. Corridors are wide enough for the widest agent.
    """

    draws_level: ClassVar[bool] = True

    columns: int = number(6, low=1, high=MOST, unit="cells", about="cells from left to right")
    rows: int = number(6, low=1, high=MOST, unit="cells", about="cells from bottom to top")
    loops: float = number(0.1, low=0, high=1, about="probability of leaving out a wall that the maze can do without")
    thickness: float = number(0.4, low=0.004, high=FAR, unit="metres", about="thickness of a wall")
    blocks: int = number(
        0, low=0, high=450, about="room for this many walls, where the cells vary; 0: as many as these cells need"
    )

    def most_blocks(self) -> int:
        return self.blocks or max(1, self.needed())

    def needed(self) -> int:
        """Return the number of blocks of a maze without loops."""
        return (self.columns - 1) * (self.rows - 1)

    def check(self, layout: Layout) -> None:
        if self.needed() > self.most_blocks():
            raise NumberError(
                f"maze.blocks = {self.blocks}: {self.columns} x {self.rows} cells need {self.needed()}; take more, or 0"
            )
        whole, sides, cells = self.whole(layout), self.inside(layout), (self.columns, self.rows)
        for side, inner, count, what in zip(whole, sides, cells, ("columns", "rows"), strict=True):
            thick = max(self.thickness, (side - inner + self.thickness) / 2)  # of both walls beside it, half each
            self.check_passage(layout, "a corridor", side / count - thick, f"fewer maze.{what} or less maze.thickness")


@Maze.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    floor: Read[Floor],
    walls: Rows[Wall],
    memory: Scratch,
    columns: int,
    rows: int,
    loops: float,
    thickness: float,
    key: Random,
) -> None:
    """Draw the maze and set up its walls."""
    open_edges(memory, columns, rows, loops, key)
    sides = (floor.size[0], floor.size[floor.size.size - 1])
    place_edges((body, shape, entities), walls, memory, columns, rows, sides, thickness, 0.0, key)
