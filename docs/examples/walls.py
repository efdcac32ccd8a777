"""A house: the room is cut into smaller rooms, with a door between any two neighbours."""

from collections.abc import Iterable
from dataclasses import dataclass

import outlast
from outlast.components import Body, Shape, Solid
from outlast.ecs import Archetype, Layout, NumberError, number
from outlast.systems import Room


@dataclass(frozen=True)
class House(Room):
    """The room with walls inside. Bodies block sight and blows without further code, so these do."""

    rooms: int = number(2, low=2, high=8, about="along each side of the square")
    door: float = number(2.5, above=0, unit="metres", about="width")

    def archetypes(self) -> Iterable[Archetype]:
        """The walls around the room, and a kind of its own for those inside: solid, and never moved."""
        pieces = self.pieces()
        x, y, half_width, half_height = (list(column) for column in zip(*pieces))
        parts = (Body(x=x, y=y), Shape(half_width=half_width, half_height=half_height), Solid())
        return [*super().archetypes(), Archetype("inner_wall", parts, len(pieces))]

    def pieces(self) -> list[tuple[float, float, float, float]]:
        """The pieces of wall between doors: x, y, half width, half height, in metres."""
        far, room, thin = self.size / 2, self.size / self.rooms, self.size * self.thickness / 2
        doors = [(k + 0.5) * room - far for k in range(self.rooms)]  # their middles, along a wall
        begins = [-far, *(middle + self.door / 2 for middle in doors)]
        ends = [*(middle - self.door / 2 for middle in doors), far]
        found = []
        for across in (k * room - far for k in range(1, self.rooms)):
            for begin, end in zip(begins, ends):
                along, half = (begin + end) / 2, (end - begin) / 2
                found += [(along, across, half, thin), (across, along, thin, half)]
        return found

    def check(self, layout: Layout) -> None:
        """Bodies start in the middle of the cells of the spawn grid, where there must be no wall."""
        if self.door >= self.size / self.rooms:
            raise NumberError(f"house.door = {self.door}: a room is only {self.size / self.rooms:g} metres wide")
        cells = layout.numbers("spawn_grid")["cells"]
        if cells % self.rooms:
            fitting = self.rooms * max(1, round(cells / self.rooms))
            raise NumberError(
                f"house.rooms = {self.rooms} does not divide spawn_grid.cells = {cells}: walls would stand on cells; "
                f"take spawn_grid_cells={fitting}"
            )


HOUSE = outlast.Scenario(
    "house",
    outlast.variant("teams_2").with_(House(size=25.0)).modules,
    "two teams of two in four rooms with doors, heals; outliving pays",
)
