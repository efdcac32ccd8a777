"""The preparation: who waits, for how long, and what waiting is."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.components import Body, Push, Sight, Weapon
from outlast.ecs import NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems import Preparation, Steering
from tests.conftest import draw_actions, scaled

WORLDS, TICKS = scaled(40, least=4), 12
WIDE = variant("teams_2").replace(room_size=100.0, agents_health=1000)  # nobody meets anybody


def make(scenario: Any = WIDE, **numbers: Any) -> SurvivalVectorEnv:
    return make_vec(scenario.with_(Preparation(ticks=TICKS, **numbers)), WORLDS, seed=2)


def play(env: SurvivalVectorEnv, ticks: int) -> Any:
    """(tick, observations, place of agents) after reset and after every step in which all push and attack."""
    observations, _ = env.reset()
    rng = np.random.default_rng(1)
    yield 0, observations, places(env)
    for tick in range(1, ticks):
        actions = draw_actions(env, rng)
        actions[..., 0], actions[..., 3] = 2, 1
        yield tick, env.step(actions)[0], places(env)


def places(env: SurvivalVectorEnv) -> Any:
    body = env.worlds[Body]
    return np.stack([body.x[:, :4], body.y[:, :4], body.angle[:, :4]], -1)


@pytest.mark.parametrize(
    "game", [WIDE, WIDE.replace(motors_give="evenly"), WIDE.with_(Steering())], ids=["at once", "evenly", "steering"]
)
@pytest.mark.parametrize("sides", [(), (0,), (1,), (0, 1)])
@pytest.mark.by_day(4)
def test_who_waits_stands_still_and_then_moves(sides: tuple[int, ...], game: Any) -> None:
    env = make(game, sides=sides)
    waiting = [i for i in range(4) if not sides or i // 2 in sides]
    acting = [i for i in range(4) if i not in waiting]
    for tick, observations, place in play(env, TICKS + 5):
        start = place if tick == 0 else start  # noqa: F821
        assert (place[:, waiting] == start[:, waiting]).all() == (tick <= TICKS)
        assert not acting or (place[:, acting] == start[:, acting]).all() == (tick == 0)
        left = observations["own"][..., env.fields["own"]["preparation"].columns][..., 0]
        assert (left[:, waiting] == max(TICKS - tick, 0)).all()
        assert (left[:, acting] == 0).all()
        assert env.observation_space.contains(observations)


def test_who_waits_does_not_attack() -> None:
    env, struck = make(sides=(1,)), {0: [], 1: []}
    for tick, _, _ in play(env, TICKS + 4):
        strikes = env.events()["strike"]
        agents = strikes["agent"] - env.worlds.span("agent").start
        for side in (0, 1):
            struck[side] += [tick] * int((agents // 2 == side).any())
    assert struck == {0: [*range(1, TICKS + 4)], 1: [*range(TICKS + 1, TICKS + 4)]}


@pytest.mark.parametrize("mode", ["masked", "revealed"])
def test_the_blind_see_nothing_until_their_first_choice(mode: str) -> None:
    env = make(variant("teams_2").replace(room_size=12.0, cameras_fov=3.0, cameras_mode=mode), sides=(0,), blind=True)
    seen = {0: 0, 1: 0}
    for tick, observations, _ in play(env, TICKS + 2):
        masks = {key: rows for key, rows in observations.items() if key in ("others_mask", "heals_mask")}
        blind = sum(rows[:, :2].sum() for rows in masks.values())
        assert (blind == 0) == (tick < TICKS)
        assert (env.worlds[Sight].visible[:, :2] == 0).all() == (tick < TICKS)
        seen[1] += sum(rows[:, 2:].sum() for rows in masks.values())
        if mode == "masked" and tick < TICKS:
            assert not observations["others"][:, :2].any()
    assert seen[1] > 0


def test_roles_wait_for_times_of_their_own() -> None:
    roles = {"seeker": outlast.role(1, preparation_ticks=TICKS), "hider": outlast.role(preparation_ticks=3)}
    env = make_vec(WIDE.with_(Preparation()).roles(**roles), WORLDS, seed=2)
    for tick, _, place in play(env, TICKS + 3):
        start = place if tick == 0 else start  # noqa: F821
        assert (place[:, 0] == start[:, 0]).all() == (tick <= TICKS)
        assert (place[:, 1:] == start[:, 1:]).all() == (tick <= 3)


def test_every_episode_begins_with_it() -> None:
    env = make()
    for _ in range(2):
        for tick, _, _ in play(env, 3):
            assert (env.worlds[Weapon].cooldown[:, :4] == TICKS - tick).all()
        assert not env.worlds[Push].x[:, :4].any()


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({"frozen": False}, "preparation.frozen and preparation.blind are both False"),
    "a third side": ({"sides": (2,)}, "side 2 does not exist; take sides from 0 to 1"),
    "a side twice": ({"sides": (0, 0)}, "a side occurs twice"),
    "half a side": ({"sides": (0.5,)}, "side 0.5 does not exist"),
    "without cameras": ({"blind": True}, "agents see everything, as cameras are missing"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused(name: str) -> None:
    numbers, message = REFUSED[name]
    scenario = WIDE.without("cameras") if name == "without cameras" else WIDE
    with pytest.raises(NumberError, match=message):
        make(scenario, **numbers)
