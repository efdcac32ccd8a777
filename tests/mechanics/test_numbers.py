"""The numbers of the mechanics: the default of each, and its range. Another one here is another game."""

import math
from dataclasses import fields
from typing import Any

import pytest

from outlast import systems
from outlast.ecs import Module, NumberError

POINTS, SOME_POINTS = "[0,1e+06]", "[1,1e+06]"  # hit points: the sum of a tick's fits into 32 bits
COUNT, POSITIVE, NOT_NEGATIVE, ANY = "[1,inf)", "(0,inf)", "[0,inf)", "(-inf,inf)"
SWITCH = ""
NUMBERS: dict[str, dict[str, tuple[Any, Any]]] = {
    "Agents": {
        "count": (2, COUNT), "radius": (0.5, "[0.002,inf)"), "density": (1.0, POSITIVE), "health": (100, SOME_POINTS),
    },
    "Pickup": {"reach": (0.5, POSITIVE), "touch": (True, SWITCH)},
    "Boxes": {
        "count": (8, COUNT), "width": (1.0, POSITIVE), "width_deviation": (1.0, NOT_NEGATIVE),
        "height": (1.5, POSITIVE), "height_deviation": (1.5, NOT_NEGATIVE), "least": (0.1, "[0.003,inf)"),
        "toughness": (5, SOME_POINTS), "owned": (True, SWITCH), "dynamic": (False, SWITCH),
        "density": (1.0, POSITIVE), "offset": (0.0, NOT_NEGATIVE), "item_radius": (0.25, "[0.002,inf)"),
        "settles": (False, SWITCH), "corners": ("lower left", ("lower left", "rolled")),
    },
    "Cameras": {
        "fov": (0.4 * math.pi, f"(0,{math.pi}]"), "depth": (10.0, POSITIVE), "cone": ("sector", ("sector", "kite")),
        "items_occlude": (True, SWITCH), "mode": ("masked", ("masked", "revealed", "omniscient")),
    },
    "Physics": {
        "rate": (60.0, POSITIVE), "substeps": (2, COUNT), "velocity_iterations": (10, COUNT),
        "position_iterations": (10, COUNT), "friction": (0.2, NOT_NEGATIVE),
        "restitution": (0.0, "[0,1]"), "linear_damping": (0.8, NOT_NEGATIVE), "angular_damping": (0.8, NOT_NEGATIVE),
        "continuous": (True, SWITCH), "backend": ("auto", ("auto", "native", "portable")),
    },
    "DeathDrop": {"radius": (0.5, NOT_NEGATIVE), "scatter": ("disc", ("disc", "rim"))},
    "DropLast": {"offset": (1.0, NOT_NEGATIVE)},
    "Ending": {"rule": ("all dead", ("all dead", "last alive")), "limit": (0, NOT_NEGATIVE)},
    "FreeForAll": {},
    "GiveLast": {"reach": (2.0, POSITIVE), "nearest": ("suitable", ("suitable", "any")), "passes_on": (False, SWITCH)},
    "Heals": {"count": (15, COUNT), "radius": (0.25, "[0.002,inf)"), "amount": (75, POINTS)},
    "Inventory": {"slots": (4, COUNT)},
    "Maze": {
        "columns": (6, "[1,32]"), "rows": (6, "[1,32]"), "loops": (0.1, "[0,1]"), "thickness": (0.4, "[0.004,1e5]"),
        "blocks": (0, "[0,450]"),
    },
    "Melee": {
        "reach": (2.0, POSITIVE), "damage": (5, POINTS), "cooldown": (0, NOT_NEGATIVE),
        "blocked": (False, SWITCH),
    },
    "Mortality": {"limit": (0, POINTS)},
    "Motors": {
        "ahead": (0.25, NOT_NEGATIVE), "left": (0.25, NOT_NEGATIVE), "turn": (0.0125, NOT_NEGATIVE),
        "give": ("evenly", ("evenly", "at once")),
    },
    "Pillars": {
        "count": (12, "[1,450]"), "least": (0.8, "[0.004,1e5]"), "most": (1.6, "[0.004,1e5]"), "gap": (1.2, "(0,1e5]"),
    },
    "Record": {},
    "Rewards": {
        "alive": (1.0, ANY), "dead": (0.0, ANY), "kill": (0.0, ANY), "death": (0.0, ANY), "posthumous": (True, SWITCH),
        "basis": ("side", ("side", "members")), "outlive": (0.0, ANY),
    },
    "Room": {
        "size": (25.0, "[1,1e5]"), "walls": (True, SWITCH), "thickness": (0.01, "[0.003,0.5]"),
        "width": (0.0, "[0,1e5]"), "height": (0.0, "[0,1e5]"),
    },
    "Rooms": {
        "columns": (3, "[1,32]"), "rows": (3, "[1,32]"), "doors": (0.5, "[0,1]"), "door": (1.6, "(0,1e5]"),
        "thickness": (0.4, "[0.004,1e5]"), "blocks": (0, "[0,450]"),
    },
    "SafeZone": {
        "radii": ((12.5, 10.0, 7.5, 5.0, 4.0, 2.0, 1.0), POSITIVE), "stand": (100, NOT_NEGATIVE),
        "shrink": (100, COUNT), "damage": (1, POINTS), "centres": ("random", ("random", "middle")),
    },
    "SpawnGrid": {"cells": (8, COUNT)},
    "Steering": {"speed": (5.0, NOT_NEGATIVE), "spin": (math.pi, NOT_NEGATIVE)},
    "Teams": {"count": (2, COUNT)},
    "Walls": {"layout": ((), "[-10000,10000]")},
}  # fmt: skip
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
