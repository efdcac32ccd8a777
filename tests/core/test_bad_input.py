"""What must be refused: each error names the value and what is allowed, and the refused call changes nothing.

See also tests/adapters/test_adapters.py, which gives bad actions, seeds and options to the batched environment, too.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.ecs import NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import ActionError, NotResetError
from outlast.errors import ScenarioError
from outlast.systems import Melee, Teams
from tests.conftest import digest, draw_actions
from tests.helpers.refusals import refuses

WORLDS = 3
Env = SurvivalVectorEnv


@pytest.fixture(scope="module")
def pair() -> list[Env]:
    return [make_vec("teams_3", WORLDS, seed=0) for _ in range(2)]


def filled(value: Any, dtype: Any = None) -> Any:
    return np.full((WORLDS, 4, 6), value, dtype)


SHAPE = ("actions", "(worlds, agents, actions) = (3, 4, 6)")
ACTIONS = {
    "a world too few": (filled(0)[:2], *SHAPE),
    "a list of unequal lists": ([[0, 1], [0]], *SHAPE),
    "NaN": (filled(np.nan), "float64", "integers are needed"),
    "objects": (filled(1, object), "object", "integers are needed"),
    "too high for a switch": (
        np.where(np.arange(72).reshape(3, 4, 6) == 71, 2, 0),
        "action 5 (give) of agent 3 in world 2 is 2",
        "0 to 1",
    ),
    "unsigned and too high": (filled(2**64 - 1, np.uint64), f"is {2**64 - 1}", "0 to 2"),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_are_refused(pair: list[Env], name: str) -> None:
    actions, *words = ACTIONS[name]
    refuses(pair, lambda env: env.step(actions), ActionError, *words)


@pytest.mark.parametrize("dtype", ["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "list", "tuple", "fortran"])
def test_actions_of_every_integer_type_mean_the_same(pair: list[Env], dtype: str) -> None:
    for env in pair:
        env.reset(seed=4)
    actions = draw_actions(pair[0], np.random.default_rng(3))
    kinds: dict[str, Any] = {
        "list": actions.tolist(), "tuple": tuple(map(tuple, actions.tolist())), "fortran": np.asfortranarray(actions),
    }  # fmt: skip
    pair[0].step(actions)
    pair[1].step(kinds[dtype] if dtype in kinds else actions.astype(dtype))
    assert digest(pair[0].worlds) == digest(pair[1].worlds)


def test_without_the_range_check_types_and_shapes_are_still_refused() -> None:
    env = make_vec("teams_3", WORLDS, seed=0, check_actions=False)
    env.reset()
    before = digest(env.worlds)
    for bad in (filled(np.nan), filled(0)[:2]):
        with pytest.raises(ActionError):
            env.step(bad)
    assert digest(env.worlds) == before
    observations, *_ = env.step(filled(100, np.int64))
    assert all(np.isfinite(values).all() for values in observations.values())


def masked(mask: Any) -> dict[str, Any]:
    return {"options": {"reset_mask": mask}}


MASK = ("reset_mask", "bool", "(3,)")
RESETS: dict[str, tuple[Any, ...]] = {
    "seed below zero": ({"seed": -1}, "seed = -1", "0 to 2**64 - 1"),
    "a seed too few": ({"seed": [1, 2]}, "seed", "(2,)", "one for each of 3 worlds"),
    "one seed a list": ({"seed": [1, [2], 3]}, "seed = [2]", "integer"),
    "mask of integers": (masked([1, 0, 1]), *MASK),
    "mask too short": (masked([True, False]), *MASK),
    "mask of none": (masked([False] * 3), *MASK, "at least one True"),
    "bad mask and good seed": ({"seed": 9, **masked([True])}, *MASK),
    "good mask and bad seed": ({"seed": -9, **masked([True] * 3)}, "seed = -9", "0 to 2**64 - 1"),
    "an unknown option": ({"options": {"mask": [True] * 3}}, "mask", "reset_mask"),
}


@pytest.mark.parametrize("name", RESETS)
def test_resets_are_refused(pair: list[Env], name: str) -> None:
    keywords, *words = RESETS[name]
    refuses(pair, lambda env: env.reset(**keywords), ValueError, *words)


def test_nothing_steps_or_is_seen_before_reset() -> None:
    env = make_vec("teams_3", 2, seed=0, render_mode="ansi")
    actions = np.zeros((2, 4, 6), int)
    for started in range(2):
        before = digest(env.worlds)
        with pytest.raises(NotResetError, match=rf"step\(\) before reset\(\): {2 - started} worlds .*; reset them"):
            env.step(actions)
        with pytest.raises(NotResetError, match=rf"render\(\) before reset\(\): {2 - started} worlds"):
            env.render()
        for name in ("observe", "state", "action_masks"):
            with pytest.raises(NotResetError, match=rf"{name}\(\) before reset\(\): {2 - started} worlds"):
                getattr(env, name)()
        assert digest(env.worlds) == before
        env.reset(options={"reset_mask": np.arange(2) == started})
    env.step(actions)
    assert len(env.render() or ()) == 2


OPTIONS: dict[str, tuple[Any, ...]] = {
    "threads a float": ({"threads": 2.0}, "threads = 2.0", "integer"),
    "first world below zero": ({"first_world": -1}, "first_world = -1", ">= 0"),
    "first world beyond all": ({"first_world": 2**63}, "first_world = 9223372036854775808", "<= 1,000,000,000,000"),
    "seed below zero": ({"seed": -1}, "seed = -1", "0 to 2**64 - 1"),
    "unknown actions": ({"actions": "discrete"}, "actions = 'discrete': allowed are 'multi', 'joint', 'continuous'"),
    "masks of floats": ({"actions": "continuous", "action_masks": True}, "discrete actions only; take 'multi' or "),
    "unknown observations": ({"observations": "box"}, "observations = 'box': allowed are 'dict', 'flat'"),
    "specialize a word": ({"specialize": "no"}, "specialize = 'no'", "True and False"),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_options_are_refused(name: str) -> None:
    keywords, *words = OPTIONS[name]
    with pytest.raises(ValueError, match=".*".join(map(re.escape, words))):
        make_vec("teams_3", **({"num_worlds": 2} | keywords))


def teams(**numbers: Any) -> Callable[[], Any]:
    return lambda: make_vec(variant("teams_3").replace(**numbers), 1)


SCENARIOS: dict[str, tuple[Any, ...]] = {
    # names
    "unknown variant": (lambda: make_vec("teams_5", 1), ScenarioError, "'teams_5'", "did you mean teams_", "ffa_1"),
    "variant a number": (lambda: make_vec(3, 1), ScenarioError, "3", "a Scenario or the name of one"),
    "without an unknown module": (lambda: variant("ffa_1").without("lasers"), ScenarioError, "'lasers'", "melee"),
    "one module twice": (
        lambda: outlast.Scenario("twice", (Melee(), Melee(damage=6))), ScenarioError, "twice", "Melee", "with_()",
    ),
    "two kinds of sides": (
        lambda: outlast.Scenario("both", (outlast.systems.FreeForAll(), Teams())), ScenarioError, "both", "FreeForAll",
    ),
    "unknown number": (teams(melee_damge=3), NumberError, "'melee_damge'", "did you mean melee_damage or melee_reach?"),
    "unknown module in a number": (teams(laser_damage=3), NumberError, "'laser_damage'", "did you mean"),
    "unknown n_": (teams(n_lasers=3), NumberError, "'n_lasers'", "n_agents"),
    # numbers, of which tests/mechanics/test_numbers.py tries all ranges
    # numbers that do not fit together
    "zone wider than the room": (teams(safe_zone_radii=(13.0,)), NumberError, "safe_zone.radii", "13", "side 25"),
    "room too small for the zone": (
        teams(room_size=10.0, safe_zone_radii=(12.5, 5.0)), NumberError, "safe_zone.radii", "12.5", "side 10", "=5,2",
    ),
    "room too small": (teams(agents_radius=20), NumberError, "radius = 20 does not fit", "side 25: at most 12.5"),
    "room too small for heals": (teams(heals_radius=13), NumberError, "heals.radius = 13", "at most 12.5"),
    "room too small for items": (teams(boxes_item_radius=13), NumberError, "boxes.item_radius = 13", "at most 12.5"),
    "room too small for boxes": (teams(boxes_height=26), NumberError, "boxes.height = 26", "at most 25"),
    "more bodies than cells": (teams(n_heals=53), NumberError, "65 bodies (", "4 agent", "53 heal", "8 x 8 = 64"),
    "more teams than agents": (teams(teams_count=5), NumberError, "teams.count = 5", "4 agents"),
    "more bodies than Box2D gets": (
        teams(n_agents=600, spawn_grid_cells=32), NumberError, "612 bodies", "512",
    ),
    # modules that miss each other, see also NEEDED in test_scenario.py
    "no agent is paid": (
        lambda: make_vec(variant("ffa_1").without("rewards", "record"), 1), ScenarioError, "Reward", "rewards",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_are_refused(name: str) -> None:
    call, error, *words = SCENARIOS[name]
    with pytest.raises(error) as raised:
        call()
    for word in words:
        assert word in str(raised.value)
