"""What must be refused: each error names the value and what is allowed, and the refused call changes nothing."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.ecs import NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import ActionError, NotResetError
from outlast.errors import ScenarioError
from outlast.systems import Boxes, Melee, Teams
from tests.conftest import COMPILED, digest, draw_actions

WORLDS = 3
Env = SurvivalVectorEnv


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[Env, Env]]:
    """Two equal environments: one gets the bad input, the other does not."""
    yield (one := make_vec("teams_3", WORLDS, seed=0)), (other := make_vec("teams_3", WORLDS, seed=0))
    one.close()
    other.close()


def refuses(pair: tuple[Env, Env], call: Callable[[Env], Any], error: type[Exception], *words: str) -> None:
    """`call` raises `error` with all `words` in its message; then, and in the next step, all is as without it."""
    rng = np.random.default_rng(1)
    for env in pair:
        env.reset(seed=4)
    for actions in (draw_actions(pair[0], rng) for _ in range(3)):
        for env in pair:
            env.step(actions)
    before = digest(pair[0].worlds)
    with pytest.raises(error) as raised:
        call(pair[0])
    assert type(raised.value) is error
    for word in words:
        assert word in str(raised.value)
    assert digest(pair[0].worlds) == before == digest(pair[1].worlds)
    actions = draw_actions(pair[0], rng)
    results = [env.step(actions) for env in pair]
    assert [np.array_equal(a, b) for a, b in zip(results[0][1:4], results[1][1:4], strict=True)] == [True] * 3
    assert digest(pair[0].worlds) == digest(pair[1].worlds) != before


def filled(value: Any, dtype: Any = None) -> Any:
    return np.full((WORLDS, 4, 6), value, dtype)


def changed(where: tuple[int, int, int], value: int) -> Any:
    actions = filled(0, np.int64)
    actions[where] = value
    return actions


SHAPE = ("actions", "(worlds, agents, actions) = (3, 4, 6)")
ACTIONS = {
    "no world axis": (filled(0)[0], *SHAPE),
    "a world too few": (filled(0)[:2], *SHAPE),
    "an agent too many": (np.zeros((3, 5, 6), int), *SHAPE),
    "an action too few": (filled(0)[..., :5], *SHAPE),
    "empty": ([], *SHAPE),
    "a list of unequal lists": ([[0, 1], [0]], *SHAPE),
    "a dict": ({"attack": 1}, *SHAPE),
    "NaN": (filled(np.nan), "float64", "integers are needed"),
    "half floats": (filled(1, np.float16), "float16", "integers are needed"),
    "truth values": (filled(True), "bool", "integers are needed"),
    "strings": (filled("1"), "<U1", "integers are needed"),
    "objects": (filled(1, object), "object", "integers are needed"),
    "dates": (filled(np.datetime64("2020-01-01")), "datetime64", "integers are needed"),
    "too high for a motor": (changed((1, 2, 0), 3), "action 0 (ahead) of agent 2 in world 1 is 3", "0 to 2"),
    "too high for a switch": (changed((2, 3, 5), 2), "action 5 (give) of agent 3 in world 2 is 2", "0 to 1"),
    "below zero": (changed((0, 0, 2), -1), "action 2 (turn) of agent 0 in world 0 is -1", "0 to 2"),
    "far too low": (changed((0, 1, 3), -(2**63)), f"is {-(2**63)}", "0 to 1"),
    "high byte of a wrap-around": (changed((0, 0, 0), 256), "is 256", "0 to 2"),
    "unsigned and too high": (filled(2**64 - 1, np.uint64), f"is {2**64 - 1}", "0 to 2"),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_are_refused(pair: tuple[Env, Env], name: str) -> None:
    actions, *words = ACTIONS[name]
    refuses(pair, lambda env: env.step(actions), ActionError, *words)


@pytest.mark.parametrize("dtype", ["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "list", "tuple", "fortran"])
def test_actions_of_every_integer_type_mean_the_same(pair: tuple[Env, Env], dtype: str) -> None:
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
    "seed too large": ({"seed": 2**64}, f"seed = {2**64}", "0 to 2**64 - 1"),
    "seed with a fraction": ({"seed": 1.5}, "seed = 1.5", "integer"),
    "seed a truth value": ({"seed": True}, "seed = True", "integer"),
    "seed a string": ({"seed": "7"}, "seed = '7'", "integer"),
    "a seed too few": ({"seed": [1, 2]}, "seed", "(2,)", "one for each of 3 worlds"),
    "one seed a list": ({"seed": [1, [2], 3]}, "seed = [2]", "integer"),
    "one seed below zero": ({"seed": [1, -2, 3]}, "seed = -2", "0 to 2**64 - 1"),
    "mask of integers": (masked([1, 0, 1]), *MASK),
    "mask too short": (masked([True, False]), *MASK),
    "mask of none": (masked([False] * 3), *MASK, "at least one True"),
    "mask of unequal lists": (masked([[True], [True, False]]), *MASK),
    "bad mask and good seed": ({"seed": 9, **masked([True])}, *MASK),
    "good mask and bad seed": ({"seed": -9, **masked([True] * 3)}, "seed = -9", "0 to 2**64 - 1"),
    "an unknown option": ({"options": {"mask": [True] * 3}}, "mask", "reset_mask"),
    "options a list": ({"options": [True] * 3}, "options", "reset_mask"),
}


@pytest.mark.parametrize("name", RESETS)
def test_resets_are_refused(pair: tuple[Env, Env], name: str) -> None:
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
    "no worlds": ({"num_worlds": 0}, "num_worlds = 0", ">= 1"),
    "no threads": ({"threads": 0}, "threads = 0", ">= 1"),
    "threads a float": ({"threads": 2.0}, "threads = 2.0", "integer"),
    "first world below zero": ({"first_world": -1}, "first_world = -1", ">= 0"),
    "first world beyond all": ({"first_world": 2**63}, "first_world = 9223372036854775808", "<= 1,000,000,000,000"),
    "seed below zero": ({"seed": -1}, "seed = -1", "0 to 2**64 - 1"),
    "unknown autoreset": ({"autoreset_mode": "never"}, "autoreset_mode", "'never'", "NextStep", "SameStep", "Disabled"),
    **{
        f"{flag} a word": ({flag: "no"}, f"{flag} = 'no'", "True and False")
        for flag in ("copy", "check_actions", "scaled", "action_masks", "specialize")
    },
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
    "variant in capitals": (lambda: variant("FFA_1"), ScenarioError, "'FFA_1'", "known: ffa_1 (1v1_heals_low)"),
    "variant misspelt": (lambda: variant("2v2_all_mit"), ScenarioError, "did you mean 2v2_all_mid"),
    "variant a number": (lambda: make_vec(3, 1), ScenarioError, "3", "a Scenario or the name of one"),
    "without an unknown module": (lambda: variant("ffa_1").without("lasers"), ScenarioError, "'lasers'", "melee"),
    "without an absent module": (lambda: variant("ffa_1").without(Boxes), ScenarioError, "'Boxes'", "heals"),
    "one module twice": (
        lambda: outlast.Scenario("twice", (Melee(), Melee(damage=6))), ScenarioError, "twice", "Melee", "with_()",
    ),
    "two kinds of sides": (
        lambda: outlast.Scenario("both", (outlast.systems.FreeForAll(), Teams())), ScenarioError, "both", "FreeForAll",
    ),
    "unknown number": (teams(melee_damge=3), NumberError, "'melee_damge'", "did you mean melee_damage or melee_reach?"),
    "unknown module in a number": (teams(laser_damage=3), NumberError, "'laser_damage'", "did you mean"),
    "number of an absent module": (
        lambda: variant("ffa_1").replace(boxes_count=3), NumberError, "'boxes_count'", "heals_count",
    ),
    "unknown n_": (teams(n_lasers=3), NumberError, "'n_lasers'", "n_agents"),
    # numbers, of which tests/mechanics/test_numbers.py tries all ranges
    "agents a truth value": (teams(n_agents=True), NumberError, "agents.count = True", "integer"),
    "radius an array": (teams(agents_radius=np.ones(2)), NumberError, "agents.radius", "finite number"),
    "choice an array": (teams(cameras_cone=np.ones(2)), NumberError, "cameras.cone", "'sector', 'kite'"),
    "zone radii a string": (teams(safe_zone_radii="5"), NumberError, "safe_zone.radii = '5'", "tuple"),
    # numbers that do not fit together
    "no zone radii": (teams(safe_zone_radii=()), NumberError, "safe_zone.radii", "empty", "leave SafeZone out"),
    "zone wider than the room": (teams(safe_zone_radii=(13.0,)), NumberError, "safe_zone.radii", "13", "side 25"),
    "room too small for the zone": (
        teams(room_size=10.0, safe_zone_radii=(12.5, 5.0)), NumberError, "safe_zone.radii", "12.5", "side 10", "=5,2",
    ),
    "room too small": (teams(agents_radius=20), NumberError, "radius = 20 does not fit", "side 25: at most 12.5"),
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
    "it never ends": (
        lambda: make_vec(variant("ffa_1").without("ending", "rewards", "record"), 1), ScenarioError, "Reward", "End",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_are_refused(name: str) -> None:
    call, error, *words = SCENARIOS[name]
    with pytest.raises(error) as raised:
        call()
    for word in words:
        assert word in str(raised.value)


@pytest.mark.skipif(COMPILED, reason="compiled, there is a native backend")
def test_the_native_backend_is_refused_where_kernels_are_not_compiled() -> None:
    from outlast.systems.box2d.batch import IncompatibleBox2D

    with pytest.raises(IncompatibleBox2D, match="NUMBA_DISABLE_JIT"):
        teams(physics_backend="native")()
