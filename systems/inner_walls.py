"""The base of walls inside the room; Walls, Maze, Rooms, Pillars and your own generators set up the blocks.

A generator extends InnerWalls: it has the maximum number of blocks, and a system `build` of phase SPAWN,
before=(Body, Shape, Entity), which sets up some of them by `place_block` (docs/levels.md).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Before,
    Body,
    Filter,
    Floor,
    Phase,
    Polygon,
    Shape,
    Side,
    Solid,
    Spawned,
    StartAreas,
    Strike,
    Unplaced,
    Wall,
    Weapon,
)
from outlast.components.body import room_sides
from outlast.components.wall import NAME
from outlast.ecs import (
    Archetype,
    Bitset,
    Entity,
    Layout,
    Module,
    NumberError,
    Random,
    Read,
    RowIndex,
    Rows,
    Scratch,
    Singleton,
    Write,
)
from outlast.ecs.kernels.simd import SIMD_WIDTH, load_flags, to_bits

from .geometry.aabb import make_half_extents
from .geometry.barriers import first_barrier, hold_back
from .geometry.blocks import alive_bits, block_span, first_row
from .geometry.mazes import make_grid_memory
from .geometry.places import fill_floor, measure, place_all

SPARE = 0.1  # metres by which a passage must be wider than the widest agent


@dataclass(frozen=True)
class InnerWalls(Module):
    """Base of mechanics that set up blocks; each has a system `build`, which does so at reset.

    Bodies that would start inside another one get a free place; a box without a place is halved until it fits. A body
    whose centre is pushed into a block, such as by a box that is set up next to it, stays on its side of the block.
    """

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype(NAME, (Body(), Shape(), Solid(), Wall()), self.most_blocks(), alive=False, order=60)]

    def singletons(self) -> Iterable[Singleton]:
        return [Before(), Unplaced(), StartAreas()]

    def dims(self) -> dict[str, int | str]:
        return {"start areas": self.most_areas() + 1}  # with the room

    def most_areas(self) -> int:
        """Return the maximum number of start areas that `build` writes."""
        return 0

    def most_blocks(self) -> int:
        """Return the maximum number of blocks, at least 1."""
        raise NotImplementedError(
            "InnerWalls is not a mechanic by itself: take Walls, Maze, Rooms or Pillars, or extend it"
        )

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        match name:
            case "memory":
                return make_grid_memory()
            case "half_extents":
                return make_half_extents(dims)
        return np.zeros(dims["blocks"], np.int32)  # obstacles

    def whole(self, layout: Layout) -> tuple[float, float]:
        """Return width and height of the room, metres. NumberError without a room."""
        sides = room_sides(layout)
        if sides is None:
            raise NumberError(f"{self.name} needs a room to stand in; add Room")
        return sides

    def inside(self, layout: Layout) -> tuple[float, float]:
        """Return width and height of the floor between the room's own walls, metres. NumberError without a room."""
        (width, height), room = self.whole(layout), layout.numbers("room")
        thick = room["thickness"] if room.get("walls") else 0.0
        return width * (1 - thick), height * (1 - thick)

    def check_passage(self, layout: Layout, what: str, wide: float, cure: str) -> None:
        """Raise NumberError unless the widest agent fits through a passage.

        Args:
            layout: The layout of all modules of the scenario.
            what: The passage, for the message.
            wide: Width of the passage, metres.
            cure: What to change, for the message.
        """
        if wide < (needed := passage(layout)):
            raise NumberError(
                f"{self.name}: {what} would be {wide:.3g} m wide, but agents need {needed:.3g} m "
                f"(their diameter and {SPARE:g} m); take {cure}"
            )


def passage(layout: Layout) -> float:
    """Return the width that the widest agent needs to get through, metres."""
    radii = layout.prefab_values(Shape, "radius").get("agent", 0.0)
    return float(2 * np.max(radii) + SPARE)


@InnerWalls.system(Phase.SPAWN, after=("inner_walls", Body), before=Shape)
def find_places(
    body: Write[Body],
    shape: Write[Shape],
    spawned: Write[Spawned],
    unplaced: Write[Unplaced],
    areas: Write[StartAreas],
    wall: Write[Wall],
    entities: Read[Entity],
    side: Read[Side],
    floor: Read[Floor],
    rows: Rows[Spawned],
    index: RowIndex[Spawned],
    agents: RowIndex[Side],
    solids: Rows[Solid],
    walls: Rows[Wall],
    half_extents: Scratch,
    obstacles: Scratch,
    polygons: Read[Polygon] | None,
    key: Random,
) -> None:
    """Move bodies that stand inside another one, or outside their start areas, to a free place. Agents come first."""
    fill_floor(areas.area[areas.area.shape[0] - 1], floor)
    tables = (body, shape, entities, floor, half_extents, obstacles)
    measure(wall, walls, half_extents, body, shape)
    missed = place_all(tables, spawned, side, solids, (rows, index, agents), areas.area, key, polygons)
    unplaced.bodies[0] = np.int32(missed)


@InnerWalls.system(Phase.MOVE, before=Body)
def remember(before: Write[Before], body: Read[Body], solid: Read[Solid], solids: Bitset[Solid]) -> None:
    """Record the positions of bodies before they move."""
    for b in range(solids.size):
        pending = solids[b] & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * b)) if solids[b] else 0
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            before.x[e], before.y[e] = body.x[e], body.y[e]


@InnerWalls.system(Phase.MOVE, after=("room", Body))
def keep_out(
    body: Write[Body],
    before: Read[Before],
    shape: Read[Shape],
    solid: Read[Solid],
    wall: Read[Wall],
    entities: Read[Entity],
    filters: Read[Filter] | None,
    filtered: RowIndex[Filter] | None,
    solids: Bitset[Solid],
    walls: Bitset[Wall],
) -> None:
    """Keep a body that was pushed into or through a block on its side of the block."""
    span = block_span(walls)
    for b in range(solids.size):
        touching = load_flags(solid.dynamic, SIMD_WIDTH * b) & load_flags(solid.may_collide, SIMD_WIDTH * b)
        pending = alive_bits(entities, solids, b) & to_bits(touching)
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            hold_back(body, before, shape, wall, entities, filters, filtered, walls, span, e)


@InnerWalls.system(Phase.MELEE, after="melee.aim", before="melee.strike")
def stop_blows(
    weapon: Write[Weapon],
    strikes: Write[Strike],
    body: Read[Body],
    shape: Read[Shape],
    wall: Read[Wall],
    entities: Read[Entity],
    walls: Bitset[Wall],
    armed: Rows[Weapon],
    filters: Read[Filter] | None,
    polygons: Read[Polygon] | None,
) -> None:
    """Make strikes that would go through a block hit the block."""
    span = block_span(walls)
    for k in range(strikes.count[0]):
        me, target = strikes.agent[k], strikes.target[k]
        if target >= 0:
            barrier = first_barrier(body, shape, wall, entities, filters, walls, span, me, target, polygons)
            strikes.target[k] = np.int32(barrier)
            weapon.target[me] = strikes.target[k]
