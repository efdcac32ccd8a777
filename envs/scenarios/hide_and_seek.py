"""The scenarios of hide and seek (arXiv 1909.07528), in two dimensions: `outlast rollout hide_2v2`.

Lengths are the published ones, in metres. What differs, and why: an agent is a disc with a radius of 0.2 m, which fits
through a published door; it steers in seven levels each way (eleven), as Steering does everywhere here; an episode has
240 ticks, as in published rooms, also in the quadrant (80), as a published step takes an agent some three times as far.
"""

import math

from outlast.ecs import Module, role
from outlast.systems import (
    Agents,
    Cameras,
    Ending,
    Lidar,
    Physics,
    Preparation,
    Record,
    Room,
    Rooms,
    SpawnGrid,
    Steering,
    Teams,
)
from outlast.systems.hide_and_seek import Climbing, Handling, Hiding, Quadrant, Things

from .hiding_policies import scripted
from .scenario import Scenario

FLOOR, TICKS, PREPARATION = 6.0, 240, 0.4  # floor_size; horizon; prep_fraction
LIDAR = Lidar(rays=30, depth=FLOOR)  # lidar.py: 30 rays all around, range 6


def hide_and_seek(
    name: str, about: str, *mechanics: Module, hiders: int = 2, seekers: int = 2, ticks: int = TICKS
) -> Scenario:
    """Return a scenario of the game, with these mechanics besides, such as walls, or in place of those of their kind.

    hiders, seekers: Agents of side 0, and of side 1. ticks: Length of an episode; the first 40 % are the preparation.
    """
    usual = (
        Agents(count=hiders + seekers, radius=0.2, density=4.0),
        Teams(count=2, sizes=(hiders, seekers)),
        Room(size=FLOOR),
        SpawnGrid(cells=4),
        Steering(speed=2.0, spin=math.pi),
        Physics(),
        Cameras(fov=0.75 * math.pi, depth=1.5 * FLOOR),  # line_of_sight.py: 3/8 pi to either side
        Preparation(ticks=int(PREPARATION * ticks), sides=(1,), blind=True),
        Things(),
        Handling(),
        Climbing(),
        Hiding(),
        Ending(rule="never", limit=ticks),
        Record(),
    )
    slots = {each.slot() for each in mechanics}
    modules = (*(each for each in usual if each.slot() not in slots), *mechanics)
    # roles are not observed, as teams are
    named = Scenario(name, modules).roles(observed=False, hider=role(count=hiders), seeker=role(count=seekers))
    return Scenario(name, modules, about, by_role=named.by_role, policies={"scripted": scripted})


_ROOMS = Rooms(columns=2, rows=2, doors=1.0, door=0.5, thickness=0.1)  # n_rooms=4
_SMALLER = Things(crates=4, planks=3, ramps=2, size=0.45, lockable_ramps=True)  # a plank fits into a cell of SpawnGrid
HIDE_2V2 = hide_and_seek("hide_2v2", "two against two: a quadrant, two crates and a ramp", Quadrant(), LIDAR)
HIDE_DOOR = hide_and_seek(
    "hide_door",
    "two against two: hiders begin in a quadrant with one door and two crates",
    *(Quadrant(closed=1.0, hiders_inside=True), Things(ramps=0), LIDAR),
)
HIDE_SMALL = hide_and_seek(
    "hide_small",
    "one against one: the hider begins in a small quadrant with one door and a crate",
    *(Quadrant(share=0.35, closed=1.0, hiders_inside=True), Handling(reach=0.5), Things(crates=1, ramps=0), LIDAR),
    hiders=1,
    seekers=1,
)
HIDE_FULL = hide_and_seek(
    "hide_full",
    "two against two: four rooms, three crates, three planks, two ramps that can be locked",
    *(_ROOMS, Things(crates=3, planks=3, ramps=2, lockable_ramps=True), LIDAR),
)
HIDE_OPEN = hide_and_seek(
    "hide_open",
    "two against two: an open floor, crates and planks to build from, a penalty beyond its edge",
    *(Room(size=FLOOR, walls=False), _SMALLER, LIDAR),
)
SCENARIOS = {each.name: each for each in (HIDE_SMALL, HIDE_DOOR, HIDE_2V2, HIDE_FULL, HIDE_OPEN)}
