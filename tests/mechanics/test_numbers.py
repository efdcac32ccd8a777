"""The numbers of the mechanics: the default of each, and its range. Another one here is another game."""

import math
from dataclasses import fields
from typing import Any

import pytest

from outlast import systems
from outlast.ecs import Module, NumberError

POINTS, SOME_POINTS = "[0,1e+06]", "[1,1e+06]"  # hit points: the sum of a tick's fits into 32 bits
MANY, POSITIVE, FAR, FROM_0, STRONG = "[1,65536]", "(0,inf)", "(0,1e4]", "[0,1e4]", "[0,1e5]"  # components/limits.py
DENSITY, RADIUS, TICKS, REWARD = "[0.001,1e6]", "[0.002,1e4]", "[0,1e9]", "[-1e9,1e9]"
SWITCH = ""
NUMBERS: dict[str, dict[str, tuple[Any, Any]]] = {
    "Agents": {
        "count": (2, "[1,4096]"), "radius": (0.5, RADIUS), "density": (1.0, DENSITY), "health": (100, SOME_POINTS),
    },
    "Pickup": {"reach": (0.5, FAR), "touch": (True, SWITCH)},
    "Behaviour": {"cells": (8, "[1,32]"), "need": (0.5, "[0,1]")},
    "Boxes": {
        "count": (8, "[0,65536]"), "width": (1.0, FAR), "width_deviation": (1.0, FROM_0),
        "height": (1.5, FAR), "height_deviation": (1.5, FROM_0), "least": (0.1, "[0.003,1e4]"),
        "toughness": (5, SOME_POINTS), "owned": (True, SWITCH), "dynamic": (False, SWITCH),
        "density": (1.0, DENSITY), "offset": (0.0, FROM_0), "item_radius": (0.25, RADIUS),
        "settles": (False, SWITCH), "corners": ("lower left", ("lower left", "rolled")),
    },
    "Cameras": {
        "fov": (0.4 * math.pi, f"(0,{math.pi}]"), "depth": (10.0, FAR), "cone": ("sector", ("sector", "kite")),
        "items_occlude": (True, SWITCH), "mode": ("masked", ("masked", "revealed", "omniscient")),
    },
    "Physics": {
        "rate": (60.0, "[1,1e4]"), "substeps": (2, "[1,100]"), "velocity_iterations": (10, "[1,1000]"),
        "position_iterations": (10, "[1,1000]"), "friction": (0.2, STRONG),
        "restitution": (0.0, "[0,1]"), "linear_damping": (0.8, STRONG), "angular_damping": (0.8, STRONG),
        "continuous": (True, SWITCH), "backend": ("auto", ("auto", "native", "portable")),
    },
    "Contacts": {"most": (256, "[1,100000]")},
    "DeathDrop": {"radius": (0.5, FROM_0), "scatter": ("disc", ("disc", "rim"))},
    "DropLast": {"offset": (1.0, FROM_0)},
    "Ending": {"rule": ("all dead", ("all dead", "last alive", "never")), "limit": (0, TICKS)},
    "FreeForAll": {},
    "GiveLast": {"reach": (2.0, FAR), "nearest": ("suitable", ("suitable", "any")), "passes_on": (False, SWITCH)},
    "Heals": {"count": (15, "[0,65536]"), "radius": (0.25, RADIUS), "amount": (75, POINTS)},
    "Inventory": {"slots": (4, MANY), "capacity": (0, "[0,65536]")},
    "Lidar": {
        "rays": (16, "[1,1024]"), "angle": (2 * math.pi, f"(0,{2 * math.pi}]"), "depth": (10.0, "[0.01,1e4]"),
        "targets": ("walls", ("walls", "solids", "bodies")),
    },
    "Maze": {
        "columns": (6, "[1,32]"), "rows": (6, "[1,32]"), "loops": (0.1, "[0,1]"), "thickness": (0.4, "[0.004,1e4]"),
        "blocks": (0, "[0,450]"),
    },
    "Melee": {
        "reach": (2.0, FAR), "damage": (5, POINTS), "cooldown": (0, TICKS),
        "blocked": (False, SWITCH),
    },
    "Mortality": {"limit": (0, POINTS)},
    "Motors": {
        "ahead": (0.25, STRONG), "left": (0.25, STRONG), "turn": (0.0125, STRONG),
        "give": ("evenly", ("evenly", "at once")),
    },
    "Pillars": {
        "count": (12, "[0,450]"), "least": (0.8, "[0.004,1e4]"), "most": (1.6, "[0.004,1e4]"), "gap": (1.2, "(0,1e4]"),
    },
    "ObserveRoles": {"count": (2, MANY)},
    "Preparation": {
        "ticks": (100, TICKS), "sides": ((), "[0,65536]"), "frozen": (True, SWITCH), "blind": (False, SWITCH),
    },
    "Record": {},
    "Respawn": {"ticks": (100, "[1,1e9]")},
    "Rewards": {
        "alive": (1.0, REWARD), "dead": (0.0, REWARD), "kill": (0.0, REWARD), "death": (0.0, REWARD),
        "posthumous": (True, SWITCH),
        "basis": ("side", ("side", "members")), "outlive": (0.0, REWARD),
    },
    "Room": {
        "size": (25.0, "[1,1e4]"), "walls": (True, SWITCH), "thickness": (0.01, "[0.003,0.5]"),
        "width": (0.0, "0 or [1,1e4]"), "height": (0.0, "0 or [1,1e4]"),
    },
    "Rooms": {
        "columns": (3, "[1,32]"), "rows": (3, "[1,32]"), "doors": (0.5, "[0,1]"), "door": (1.6, "(0,1e4]"),
        "thickness": (0.4, "[0.004,1e4]"), "blocks": (0, "[0,450]"),
    },
    "SafeZone": {
        "radii": ((12.5, 10.0, 7.5, 5.0, 4.0, 2.0, 1.0), POSITIVE), "stand": (100, TICKS),
        "shrink": (100, "[1,1e9]"), "damage": (1, POINTS), "centres": ("random", ("random", "middle")),
    },
    "SpawnGrid": {"cells": (8, "[1,256]")},
    "Steering": {"speed": (5.0, STRONG), "spin": (math.pi, STRONG)},
    "Teams": {"count": (2, MANY), "sizes": ((), "whole numbers")},  # see tests/core/test_roles.py
    "Walls": {"layout": ((), "[-8388608,10000]")},
}  # fmt: skip
NUMBERS |= {"FineMotors": NUMBERS["Motors"], "FineSteering": NUMBERS["Steering"]}
TINY, HUGE = 1e-6, 10**6


def module(name: str, **numbers: Any) -> Module:
    made: Module = getattr(systems, name)(**numbers)
    return made


def tried(default: Any, spec: Any) -> tuple[list[Any], list[Any]]:
    """What must be taken and what must be refused in the place of this default."""
    if isinstance(default, bool):
        return [True, False], [0, 1, "yes"]
    if isinstance(spec, tuple):
        return [*spec], ["", *range(len(spec))]
    if spec == "whole numbers":
        return [(), (1, 3)], [(0, 1), (1, 0.5)]
    if spec == "0 or [1,1e4]":
        return [0.0, 1.0, 1e4], [-1.0, 0.5, 1.1e4]
    one = (*default, 0.0)[0] if isinstance(default, tuple) else default
    both = limits(spec, 1 if isinstance(one, int) else TINY)
    taken, refused = ([type(one)(number) for number in numbers] for numbers in both)
    if isinstance(default, tuple):
        return [(number,) for number in taken], [(number,) for number in refused]
    return taken, refused


def limits(interval: str, step: float) -> tuple[list[float], list[float]]:
    """On both sides of both ends of an interval, as "(0,inf)"; a square bracket takes the end in."""
    taken: list[float] = []
    refused: list[float] = []
    low, high = map(float, interval[1:-1].split(","))
    for end, inwards, closed in ((low, 1, interval[0] == "["), (high, -1, interval[-1] == "]")):
        if math.isinf(end):
            taken.append(-inwards * HUGE)
        else:
            taken += [end + inwards * step, *([end] if closed else [])]
            refused += [end - inwards * step, *([] if closed else [end])]
    return taken, refused


def test_no_number_is_left_out() -> None:
    assert sorted(NUMBERS) == sorted(systems.__all__)
    assert {name: [f.name for f in fields(getattr(systems, name))] for name in NUMBERS} == {
        name: [*numbers] for name, numbers in NUMBERS.items()
    }


@pytest.mark.parametrize(("name", "number"), [(name, number) for name in NUMBERS for number in NUMBERS[name]])
def test_numbers_are_what_they_were_and_keep_to_their_range(name: str, number: str) -> None:
    default, spec = NUMBERS[name][number]
    assert getattr(module(name), number) == default
    taken, refused = tried(default, spec)
    for value in taken:
        assert getattr(module(name, **{number: value}), number) == value
    for value in refused:
        with pytest.raises(NumberError, match=number):
            module(name, **{number: value})
