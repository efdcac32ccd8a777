"""Every number of every mechanic varies, or its refusal says why: each world is the game that has its value."""

import dataclasses
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.distributions import choice
from outlast.ecs import Module, NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.scenarios.scenario import Scenario
from outlast.systems import DropLast, Maze, Pillars, Preparation, Respawn, Rooms
from tests.conftest import COMPILED, scaled

TICKS = scaled(200, least=4)
SMALL = {
    "room_size": 9.0, "safe_zone_radii": (3.9, 3.0), "safe_zone_stand": 30, "safe_zone_shrink": 30,
    "spawn_grid_cells": 5, "agents_health": 90, "boxes_count": 4, "boxes_toughness": 3, "boxes_least": 0.2,
    "boxes_width": 0.6, "boxes_height": 0.6, "heals_count": 8, "melee_reach": 3.0, "pickup_reach": 1.5,
    "rewards_kill": 3.0, "rewards_death": -2.0, "rewards_outlive": 1.0, "cameras_depth": 4.0, "inventory_slots": 3,
    "give_last_reach": 5.0, "motors_ahead": 0.5, "steering_speed": 4.0,
}  # fmt: skip
BARS = outlast.levels.FloorPlan(walls=[(-2, 0, 0.4, 3), (2, 0, 0.4, 3, 0.6)])
OTHER_BARS = outlast.levels.FloorPlan(walls=[(-2, 1, 0.4, 3), (2, 1, 0.4, 3, 0.3)])


def small(name: str, *mechanics: Module, **numbers: Any) -> Scenario:
    scenario = outlast.variant(name).with_(*mechanics)
    numbers = SMALL | numbers
    return scenario.replace(**{key: value for key, value in numbers.items() if key in scenario.numbers()})


GAMES = {
    "maze": small(
        "teams_4", DropLast(), Maze(columns=3, rows=3, thickness=0.2), Preparation(ticks=10, blind=True, sides=(0,))
    ),
    "rooms": small("ffa_3+steering", Rooms(columns=2, rows=2, thickness=0.2), DropLast(), mortality_limit=120),
    "pillars": small(
        *("teams_3+team_share", Pillars(count=2, most=1.0), Respawn(ticks=10)),
        ending_rule="never",
        ending_limit=150,
        room_size=12.0,
    ),
    "walls": small("ffa_4", BARS.mechanic(), room_width=8.8),
}
GAMES |= {name: small(name) for name in outlast.VARIANTS}
GAMES |= {f"teams_4+{name}": small(f"teams_4+{name}") for name in outlast.ABLATIONS}

OTHERS: dict[str, Any] = {  # where another value than a little less is one that can be
    "room_width": 8.5, "room_height": 8.5, "mortality_limit": 150, "pillars_gap": 1.3, "preparation_sides": (1.0,),
    "safe_zone_radii": (3.8, 2.0), "teams_sizes": (1.0, 3.0), "walls_layout": OTHER_BARS.layout(), "maze_blocks": 9,
    "rooms_blocks": 30, "physics_rate": 50.0, "physics_substeps": 3, "walls_blocks": 3, "inventory_capacity": 1,
    "boxes_least": 0.4, "agents_radius": 0.4, "heals_radius": 0.1, "melee_reach": 1.5, "cameras_depth": 2.0,
}  # fmt: skip
READ, RUNS = r"{}\(\) reads it when worlds are made", r"{}\.systems\(\) reads it: it decides which systems run"
KINDS, BESIDE = READ.format("archetypes"), "has no effect beside"
REFUSED = {
    "inventory_slots": READ.format("dims"), "spawn_grid_cells": READ.format("dims"), "room_size": KINDS,
    "maze_columns": KINDS, "maze_rows": KINDS, "maze_blocks": KINDS, "rooms_columns": KINDS, "rooms_rows": KINDS,
    "rooms_blocks": KINDS, "room_walls": KINDS, "room_thickness": KINDS, "room_width": f"{KINDS}|{BESIDE}",
    "room_height": f"{KINDS}|{BESIDE}", "preparation_frozen": RUNS.format("Preparation"),
    "preparation_blind": RUNS.format("Preparation"), "physics_backend": RUNS.format("Physics"),
    "teams_count": f"{READ.format('dims')}|are 2 teams, but teams.count is 1",
    "ending_rule": "agents return, so the death", "teams_sizes": "all tuples must have one length",
}  # fmt: skip


def other(module: Module, item: Any) -> Any:
    value = getattr(module, item.name)
    if (name := f"{module.name}_{item.name}") in OTHERS:
        return OTHERS[name]
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return next(each for each in item.metadata["choices"] if each != value)
    if isinstance(value, int):
        return value - 1 if value > 1 else value + 1
    return value * 0.98 if value else 0.3


def others(scenario: Scenario) -> dict[str, tuple[Any, Any]]:
    return {
        f"{module.name}_{item.name}": (getattr(module, item.name), other(module, item))
        for module in scenario.modules
        for item in dataclasses.fields(module)
    }


def varied(scenario: Scenario) -> dict[str, tuple[Any, Any]]:
    """Those of `others` that can vary; the test fails where a refusal says something else than in REFUSED."""
    found = {}
    for name, values in others(scenario).items():
        try:
            if name in REFUSED:  # the rest is varied at once, which raises if one of it is refused
                scenario.vary(**{name: choice(*values)}).worlds(1).close()
            found[name] = values
        except NumberError as error:
            if not re.search(REFUSED[name], str(error)):
                raise
    return found


def played(env: SurvivalVectorEnv, actions: Any, w: int = 0) -> Iterator[list[Any]]:
    """What world `w` returns, from the reset on until its episode ends."""
    observations, _ = env.reset(seed=3)
    yield [values[w] for _, values in sorted(observations.items())]
    for chosen in actions:
        observations, rewards, terminated, truncated, _ = env.step(chosen)
        yield [*(values[w] for _, values in sorted(observations.items())), rewards[w], terminated[w], truncated[w]]
        if terminated[w] or truncated[w]:
            break


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="one of the numbers is the native backend, which plain Python lacks")
@pytest.mark.parametrize("name", GAMES)
def test_a_world_is_the_game_with_its_number(name: str) -> None:
    """World k of one batch has another value of the k-th number, and the last one has none: one tick for all."""
    scenario, rng = GAMES[name], np.random.default_rng(0)
    numbers = varied(scenario)
    env = outlast.make_vec(scenario.vary(**{key: choice(*both) for key, both in numbers.items()}), len(numbers) + 1)
    for key, (value, _) in numbers.items():
        env.set_numbers({key: value})
    for k, (key, (_, value)) in enumerate(numbers.items()):
        env.set_numbers({key: value}, mask=np.arange(len(numbers) + 1) == k)
    sizes = env.single_action_space.nvec
    actions = [rng.integers(0, sizes, (env.num_worlds, *sizes.shape)) for _ in range(TICKS)]
    outcomes = [[*outcome.values()] for outcome in whole(env, actions)]
    env.close()
    for k, (key, (_, value)) in enumerate(numbers.items()):
        plain = fixed(scenario, {key: value})
        one = outlast.make_vec(plain, 1, first_world=k)
        for tick, own in enumerate(played(one, [chosen[k : k + 1, : one.num_agents] for chosen in actions])):
            for mine, its in zip(own, (values[k] for values in outcomes[tick]), strict=True):
                its = its[tuple(map(slice, mine.shape))]
                if not np.array_equal(mine, its):  # ten times as fast as what says where they differ
                    np.testing.assert_array_equal(mine, its, f"{key}, tick {tick}")
        one.close()


def fixed(scenario: Scenario, numbers: dict[str, Any]) -> Scenario:
    """The scenario with other numbers, and none that is scaled with them."""
    scaled_too = scenario.replace(**numbers)
    return scaled_too.replace(**{key: value for key, value in scenario.numbers().items() if key not in numbers})


def whole(env: SurvivalVectorEnv, actions: Any) -> Iterator[dict[str, Any]]:
    observations, _ = env.reset(seed=3)
    yield dict(sorted(observations.items()))
    for chosen in actions:
        observations, rewards, terminated, truncated, _ = env.step(chosen)
        ends = {"rewards": rewards, "terminated": terminated, "truncated": truncated}
        yield dict(sorted(observations.items())) | ends
