"""Levels that cannot be are refused in words that name the cure."""

import math
from typing import Any

import pytest

import outlast
from outlast import systems, variant
from outlast.components import Unplaced
from outlast.ecs import NumberError, Worlds
from outlast.envs.errors import FaultError
from tests.helpers.naive_walls import level

BAD: dict[str, tuple[Any, tuple[str, ...]]] = {
    "five numbers": (lambda: systems.Walls(layout=(0, 0, 1, 1, 0)), ("5 numbers", "6 for each", "FloorPlan")),
    "outside": (lambda: level((12, 0, 4, 1, 0, 0)), ("reaches to (14, 0.5)", "ends at (12.5, 12.5)", "Room(width=")),
    "turned outside": (lambda: level((11, 11, 4, 1, 0.8, 0)), ("outside of the room",)),
    "flat": (lambda: level((0, 0, 4, 0, 0, 0)), ("4 x 0 m", "at least 0.004 m")),
    "a side that is not there": (lambda: level((0, 0, 4, 4, 0, 7)), ("side 6", "sides 0 to 1")),
    "starts overlap": (lambda: level((0, 0, 4, 4, 0, 1), (1, 1, 4, 4, 0, 2)), ("overlaps that of side 0", "apart")),
    "start in a wall": (lambda: level((0, 0, 6, 6, 0, 0), (0, 0, 4, 4, 0, 1), (9, 9, 4, 4, 0, 2)), ("side 0 have no",)),
    "corridors": (lambda: systems.Maze(columns=20), ("maze: a corridor", "fewer maze.columns", "1.1 m")),
    "blocks": (lambda: systems.Maze(blocks=3), ("maze.blocks = 3", "6 x 6 cells need 25")),
    "a door": (lambda: systems.Rooms(door=0.9), ("rooms: a door would be 0.9 m wide", "larger rooms.door")),
    "a door as wide as a room": (lambda: systems.Rooms(door=8.0), ("rooms.door = 8", "must stay")),
    "too many pillars": (lambda: systems.Pillars(count=400), ("do not fit into", "take at most")),
    "a narrow gap": (lambda: systems.Pillars(gap=0.5), ("gap between two pillars would be 0.5 m", "1.1 m")),
    "sizes swapped": (lambda: systems.Pillars(least=2.0), ("above pillars.most = 1.6", "swap")),
}


@pytest.mark.parametrize("name", BAD)
def test_levels_that_cannot_be_are_refused(name: str) -> None:
    make, words = BAD[name]
    with pytest.raises(NumberError) as raised:
        Worlds(variant("ffa_1").with_(make()).modules, 1)
    for word in words:
        assert word in str(raised.value), str(raised.value)


def test_too_little_floor_is_refused() -> None:
    """Centres can be in 2 x 1.05 m along x and 8.8 m along y, which a lattice of 0.396 x 0.099 m rounds up."""
    hall = variant("ffa_1").replace(room_width=40.0, room_height=10.0, safe_zone_radii=(5.0,), n_agents=24)
    with pytest.raises(NumberError, match=r"leaves 20.7 square metres where agents can be, but they need 22.8; take"):
        Worlds(hall.with_(level((0, 0, 35.3, 10, 0, 0))).modules, 1)


def test_not_a_number_is_refused() -> None:
    with pytest.raises(NumberError, match=r"walls.layout\[2\] = nan"):
        level((0, 0, math.nan, 1, 0, 0))


def test_walls_need_a_room() -> None:
    bare = variant("ffa_1").without("room", "spawn_grid", "safe_zone")
    with pytest.raises(NumberError, match="maze needs a room to stand in; add Room"):
        Worlds(bare.with_(systems.Maze()).modules, 1)


def test_who_finds_no_place_is_an_error() -> None:
    """Here the items of a small area, which nothing says before worlds are made."""
    scenario = variant("ffa_1").with_(level((0, 0, 0.6, 0.6, 0, -1)))
    for first in (0, 40):  # by its number in the batch of all
        env = outlast.make_vec(scenario, 2, seed=0, first_world=first)
        with pytest.raises(FaultError, match=rf"world ({first}|{first + 1}): \d+ bodies found no .* leave more floor"):
            env.reset()
        assert (env.worlds[Unplaced].bodies > 0).all()
        env.close()
