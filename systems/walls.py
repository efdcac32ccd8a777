"""Walls from data: rectangles inside the room, and the areas in which agents and items start."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Phase, Shape, Spawned, StartAreas, Wall
from outlast.components.body import face
from outlast.ecs import Entity, Layout, NumberError, Rows, Write, number

from .geometry.mazes import place_block
from .geometry.places import ANGLE, ENTRY, HEIGHT, ITEMS, USE, WALL, WIDTH, X, Y, kind_use
from .geometry.plans import are_free, lattice, overlap, reach
from .inner_walls import InnerWalls, passage

HALF = np.float32(0.5)
THINNEST = 0.004  # metres: Box2D requires half sides of more than a millimetre
ROUNDING = 0.01  # maximum metres of rectangles beyond the room


@dataclass(frozen=True)
class Walls(InnerWalls):
    """Blocks that are the same in every episode; outlast.levels.FloorPlan creates them from text, files and lists.

    layout: six numbers for each rectangle, in a single row: x and y of the middle, width, height (metres), angle
    (radians), and its use: 0 for a block, 1 for the start area of side 0, 2 for that of side 1 and so on, -1 for
    that of items and boxes, and a lower number for that of a kind (places.kind_use). A rectangle of width and
    height 0 does not count, so layouts can be padded to one length and chosen from by vary(walls_layout=choice(...)).
    """

    layout: tuple[float, ...] = number(
        (),
        low=-(2.0**23),
        high=1e4,
        free=True,
        about="rectangles of a floor plan, as outlast.levels.FloorPlan makes them",
    )

    def most_blocks(self) -> int:
        return max(1, len(self.layout) // ENTRY)

    def most_areas(self) -> int:
        return len(self.layout) // ENTRY

    def check(self, layout: Layout) -> None:
        kinds = self._uses(layout)
        if len(self.layout) % ENTRY:
            raise NumberError(
                f"walls.layout has {len(self.layout)} numbers: {ENTRY} for each rectangle are needed (x, y, width, "
                "height, angle, what it is); outlast.levels.FloorPlan(...).layout() makes them"
            )
        sides = self.whole(layout)
        found = [entry for entry in entries(self.layout) if entry[WIDTH] != 0 or entry[HEIGHT] != 0]
        for k, entry in enumerate(found):
            self._check_entry(
                f"walls.layout: rectangle {k} at ({entry[X]:g}, {entry[Y]:g})", entry, sides, layout, kinds
            )
            for other in found[:k]:
                if min(entry[USE], other[USE]) > WALL and other[USE] != entry[USE] and overlap(other, entry):
                    raise NumberError(
                        f"walls.layout: the start area of {owner(entry[USE])} at ({entry[X]:g}, {entry[Y]:g}) overlaps "
                        f"that of {owner(other[USE])} at ({other[X]:g}, {other[Y]:g}); move them apart"
                    )
        self._check_space(found, layout)

    def _uses(self, layout: Layout) -> dict[float, str]:
        """Return the kinds that can have start areas, by use."""
        found = dict[float, str]()
        for name in layout.prefab_values(Spawned, "cell"):
            if (other := found.setdefault(kind_use(name), name)) != name:
                raise NumberError(f"walls.layout cannot separate start areas of '{other}' and '{name}'; rename one")
        return found

    def _check_entry(
        self, what: str, entry: tuple[float, ...], sides: tuple[float, float], layout: Layout, kinds: dict[float, str]
    ) -> None:
        """Raise NumberError for an impossible rectangle.

        Args:
            what: Its name in messages.
            entry: Its numbers.
            sides: Sides of the room, metres.
            layout: The layout of all modules of the scenario.
            kinds: The kinds that can have start areas, by use.
        """
        if min(entry[WIDTH], entry[HEIGHT]) < THINNEST:
            raise NumberError(
                f"{what} is {entry[WIDTH]:g} x {entry[HEIGHT]:g} m: at least {THINNEST:g} m are needed either way, or "
                "0 both ways for none"
            )
        far = reach(entry)
        if any(end > side / 2 + ROUNDING for end, side in zip(far, sides, strict=True)):
            raise NumberError(
                f"{what} reaches to ({far[0]:g}, {far[1]:g}), outside of the room, which ends at ({sides[0] / 2:g}, "
                f"{sides[1] / 2:g}); make it smaller, or the room larger: Room(width=..., height=...)"
            )
        count = layout.dims.get("sides", 0)
        if entry[USE] != int(entry[USE]) or not (ITEMS <= entry[USE] <= count or entry[USE] in kinds):
            raise NumberError(
                f"{what} is for {owner(entry[USE])}, but this scenario has the sides 0 to {count - 1}; take one of "
                f"these, -1 for items, or a kind that spawns: {', '.join(kinds.values())}"
            )

    def _check_space(self, found: list[tuple[float, ...]], layout: Layout) -> None:
        """Raise NumberError if the blocks leave too little floor for agents to start."""
        radius, sides = passage(layout) / 2, self.inside(layout)
        blocks = [entry for entry in found if entry[USE] == WALL]
        for use in sorted({entry[USE] for entry in found if entry[USE] > WALL}):
            areas = [entry for entry in found if entry[USE] == use]
            if not any(are_free(*lattice(area), blocks, sides, radius).any() for area in areas):
                raise NumberError(
                    f"walls.layout: the start areas of {owner(use)} have no free place for an agent of radius "
                    f"{radius:.3g} m (with what it needs around it); make them larger, or move blocks away"
                )
        free = are_free(*lattice((0, 0, *sides, 0)), blocks, sides, radius).mean() * sides[0] * sides[1]
        needed = math.pi * radius**2 * layout.dims.get("agents", 0)
        if free < needed:
            raise NumberError(
                f"walls.layout leaves {free:.3g} square metres where agents can be, but they need {needed:.3g}; take "
                "fewer or smaller agents, fewer blocks, or a larger room"
            )


def entries(layout: tuple[float, ...]) -> Iterator[tuple[float, ...]]:
    """Return the rectangles of a layout, ENTRY numbers each."""
    return zip(*[iter(layout)] * ENTRY, strict=True)


def owner(use: float) -> str:
    """Return the kind of entities that start in an area, in words."""
    return "items" if use == ITEMS else f"side {use - 1:g}" if use > ITEMS else "a kind that does not spawn here"


@Walls.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    areas: Write[StartAreas],
    walls: Rows[Wall],
    layout: tuple[float, ...],
) -> None:
    """Set up the blocks, and write the start areas."""
    count = 0
    for k in range(len(layout) // ENTRY):
        for field in range(ENTRY):
            areas.area[k, field] = layout[ENTRY * k + field]
        if layout[ENTRY * k + USE] == WALL and layout[ENTRY * k + WIDTH] > 0:
            e, angle = walls[count], layout[ENTRY * k + ANGLE]
            x, y = layout[ENTRY * k + X], layout[ENTRY * k + Y]
            place_block(
                body, shape, entities, e, x, y, HALF * layout[ENTRY * k + WIDTH], HALF * layout[ENTRY * k + HEIGHT]
            )
            face(body, e, angle)
            count += 1
