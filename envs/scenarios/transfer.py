"""The transfer tests of hide and seek (arXiv 1909.07528): tasks for one hider, with the observations of `hide_small`.

Numbers are those of examples/*.jsonnet of the published environments, with 240 ticks in place of 120 to 240 steps.
"""

import math

from outlast.ecs import Module
from outlast.systems import Agents, Cameras, Preparation, Rooms, Teams
from outlast.systems.hide_and_seek import Blueprint, Counting, Locking, Shelter, Things

from .hide_and_seek import FLOOR, HIDE_SMALL
from .scenario import Scenario

_ALONE = HIDE_SMALL.without("hiding", "quadrant").with_(
    Agents(count=1, radius=0.2, density=4.0), Teams(count=1), Preparation(ticks=0, blind=True)
)


def transfer(name: str, about: str, *mechanics: Module) -> Scenario:
    """Return a scenario in which the hider of `hide_small` is alone. mechanics: Its task, things and walls."""
    return Scenario(name, _ALONE.with_(*mechanics).modules, about)


LOCK_AND_RETURN = transfer(
    "lock_and_return",
    "transfer test: find the crate in six rooms, lock it, and come back",
    Locking(back=0.1, start=(-2.0, -1.5)),
    Rooms(columns=3, rows=2, doors=1.0, door=0.5, thickness=0.1),
)
SEQUENTIAL_LOCK = transfer(
    "sequential_lock",
    "transfer test: lock four crates in three rooms, in an order that has to be found out",
    Locking(),
    Things(crates=4, ramps=0),
    Rooms(columns=3, rows=1, doors=1.0, door=0.5, thickness=0.1),
)
BLUEPRINT = transfer("blueprint", "transfer test: bring crates to two sites", Blueprint(), Things(crates=8, ramps=0))
SHELTER = transfer(
    "shelter",
    "transfer test: shelter a pillar from all sides with crates and planks",
    Shelter(),
    Things(crates=5, planks=3, ramps=0, size=0.45),
)
OBJECT_COUNTING = transfer(
    "object_counting",
    "transfer test: see how many of six crates go to the left, without a reward",
    Counting(),
    Things(crates=6, ramps=0, size=0.2),
    Cameras(fov=0.5 * math.pi, depth=1.5 * FLOOR),
)
SCENARIOS = {each.name: each for each in (LOCK_AND_RETURN, SEQUENTIAL_LOCK, BLUEPRINT, SHELTER, OBJECT_COUNTING)}
