"""Both ends of the range of every number, alone and with those of its neighbours: a game is played, or refused."""

import dataclasses
import itertools
import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Body, Floor, Shape, Side, Wall
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.scenarios.scenario import Scenario
from outlast.errors import OutlastError
from tests.conftest import COMPILED, few_by_day, scaled
from tests.helpers.invariants import InvariantChecker
from tests.helpers.random_levels import gap

TICKS = scaled(5000, least=20)
TINY = 1e-6  # as little above an end that is not in the range
EVENTFUL: dict[str, Any] = {
    "boxes_dynamic": True, "agents_health": 1_000_000, "ending_rule": "never", "ending_limit": 1500,
}  # fmt: skip
BARS = outlast.levels.FloorPlan(walls=[(-4, 0, 0.4, 5), (4, 0, 0.4, 5, 0.6)])


def game(name: str, *mechanics: Any) -> Scenario:
    scenario = outlast.variant(name).with_(*mechanics)
    return scenario.replace(**{key: value for key, value in EVENTFUL.items() if key in scenario.numbers()})


GAMES = {
    "plain": game("teams_4"),
    "views": game("ffa_4", systems.Lidar(), systems.DropLast(), systems.Behaviour(), systems.FineSteering()),
    "maze": game("teams_4+steering", systems.Maze(columns=4, rows=4, thickness=0.2), systems.Preparation(ticks=10)),
    "rooms": game("teams_4", systems.FineMotors(), systems.Rooms(thickness=0.2), systems.Respawn()),
    "pillars": game("ffa_4", systems.Pillars(count=8), systems.Record(), systems.Contacts()),
    "walls": game("teams_3", BARS.mechanic()).roles(big=outlast.role(1), small=outlast.role()),
}


def owned() -> dict[str, str]:
    """Return the game in which each number is tried: the first that has it."""
    return {name: key for key, each in reversed(GAMES.items()) for name in each.numbers()}


GAME_OF = owned()
FIELDS = {
    f"{module.name}_{item.name}": item
    for each in GAMES.values()
    for module in each.modules
    for item in dataclasses.fields(module)
}
PARTS = ("metre", "kilogram", "second", "newton", "substep")  # of units of bodies and their motion
PHYSICAL = [name for name, item in FIELDS.items() if any(part in item.metadata.get("unit", "") for part in PARTS)]


def ends(name: str) -> list[Any]:
    """Return the values at both ends of a number's range, or all if they can be listed."""
    item = FIELDS[name]
    rule, kind = item.metadata, type(item.default)
    if kind in (bool, str):
        return [False, True] if kind is bool else [*rule["choices"]]
    low = rule["low"] if math.isfinite(rule["low"]) else rule["above"] + TINY
    values = [end for end in (low, rule["high"]) if math.isfinite(end)]
    return [(end,) for end in values] if kind is tuple else [kind(end) for end in values]


def neighbours(name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield a game, and in it the ends of a physical number with those of each later one."""
    for other in PHYSICAL[PHYSICAL.index(name) + 1 :]:
        if both := [key for key, each in GAMES.items() if {name, other} <= each.numbers().keys()]:
            yield from ((both[0], {name: one, other: two}) for one, two in itertools.product(ends(name), ends(other)))


def outcome(key: str, numbers: dict[str, Any]) -> str:
    """Play a game with these numbers, or check the words with which it is refused. Return what is wrong, or ""."""
    try:
        env = outlast.make_vec(GAMES[key].replace(**numbers), 1, seed=0)
    except OutlastError as error:
        return "" if any(named(name, value, str(error)) for name, value in numbers.items()) else f"refused: {error}"
    try:
        play(env)
    except (AssertionError, OutlastError) as error:
        return f"{type(error).__name__}: {error}"
    finally:
        env.close()
    return ""


def named(name: str, value: Any, message: str) -> bool:
    """Return whether a message names the number, or its value."""
    mechanic = next(module for module in GAMES[GAME_OF[name]].modules if name.startswith(f"{module.name}_"))
    dotted = f"{mechanic.name}.{name.removeprefix(f'{mechanic.name}_')}"
    shown = value if isinstance(value, str | bool) else f"{np.ravel(value)[0]:g}"
    return (
        dotted in message
        or name in message
        or re.search(rf"(?<![\w.]){re.escape(str(shown))}(?![\w.])", message) is not None
    )


def play(env: SurvivalVectorEnv) -> None:
    """Move agents about, one of them next to a wall at first, and check the invariants now and then."""
    checker, rng, sizes = InvariantChecker(env), np.random.default_rng(0), env.single_action_space.nvec
    env.reset()
    place_at_wall(env)
    for tick in range(TICKS):
        if tick % 7 == 0:
            actions = rng.integers(0, sizes, (1, *sizes.shape))
            actions[..., 0] = np.where(rng.random(actions.shape[:-1]) < 0.7, sizes[..., 0] - 1, actions[..., 0])
        observation = env.step(actions)[0]
        if tick % 100 == 0 or tick == TICKS - 1:
            checker.check_state(observation)
            if Wall in env.worlds:
                agents, blocks = (env.worlds.layout.rows(part) for part in (Side, Wall))
                deep = gap(env.worlds, np.zeros(1, int), agents, blocks) + env.worlds[Shape].radius[:, agents, None]
                assert deep.min(initial=np.inf) > 0, "the centre of an agent is in a block"


def place_at_wall(env: SurvivalVectorEnv) -> None:
    room, body, e = env.scenario.numbers(), env.worlds[Body], env.worlds.span("agent").start
    if Wall not in env.worlds:
        inside = env.worlds[Floor].size[0, 0] / 2 * (1 - room["room_thickness"])
        body.x[0, e] = max(inside - env.worlds[Shape].radius[0, e] - 0.05, 0)


def test_every_mechanic_is_in_a_game() -> None:
    assert {type(module).__name__ for each in GAMES.values() for module in each.modules} >= {*systems.__all__}


@pytest.mark.parametrize("name", few_by_day(FIELDS, ("agents_radius", "boxes_density", "room_width")))
def test_both_ends_of_a_number_are_played_or_refused(name: str) -> None:
    found = {value: outcome(GAME_OF[name], {name: value}) for value in ends(name)}
    assert {value: wrong for value, wrong in found.items() if wrong} == {}


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not COMPILED, reason="thousands of games")
@pytest.mark.parametrize("name", PHYSICAL[:-1])
def test_both_ends_of_neighbours_are_played_or_refused(name: str) -> None:
    """Sizes with densities, speeds with radii, the length of a tick with all of them."""
    found = [(numbers, outcome(key, numbers)) for key, numbers in neighbours(name)]
    assert [(numbers, wrong) for numbers, wrong in found if wrong] == []
