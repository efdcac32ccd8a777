"""Numbers that change while worlds run."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import NumberError
from outlast.envs.errors import RecordingError
from tests.conftest import digest, draw_actions, scaled

OTHERS = {"melee_damage": 40, "safe_zone_damage": 7, "rewards_alive": 2.5, "rewards_basis": "members"}


def played(env: Any, ticks: int) -> tuple[str, list[Any]]:
    rng, rewards = np.random.default_rng(5), []
    env.reset(seed=1)
    for _ in range(ticks):
        rewards.append(env.step(draw_actions(env, rng))[1])
    return digest(env.worlds), rewards


@pytest.mark.parametrize("threads", [1, 2])
def test_changed_numbers_are_as_those_that_worlds_were_made_with(threads: int) -> None:
    ticks, worlds, duel = scaled(200, 20), scaled(20, 3), outlast.variant("ffa_2")
    made = played(outlast.make_vec(duel.replace(**OTHERS), worlds, seed=1, threads=threads), ticks)
    env = outlast.make_vec(duel, worlds, seed=1, threads=threads)
    before = played(env, ticks)
    env.set_numbers(**OTHERS)
    found = played(env, ticks)
    assert found[0] == made[0] != before[0]
    np.testing.assert_array_equal(found[1], made[1])
    assert env.scenario == duel
    assert env.worlds.changed == OTHERS | {"rewards_basis": 1}
    env.set_numbers(**{name: duel.numbers()[name] for name in OTHERS})
    assert played(env, ticks)[0] == before[0]
    assert not env.worlds.changed


def test_motors_that_give_at_once_leave_nothing_of_before() -> None:
    """A push of the tick before, given evenly, would go on for ever."""
    env, speeds = outlast.make_vec("ffa_2", 3, seed=6, motors_give="evenly"), []
    env.reset()
    idle = np.tile(env.noop, (3, 2, 1))
    env.step(idle + np.eye(6, dtype=int)[0])
    env.set_numbers(motors_give="at once")
    body = env.worlds[Body]
    for _ in range(20):
        env.step(idle)
        speeds.append(np.hypot(body.vx, body.vy)[:, :2])
    assert (np.diff(speeds, axis=0) < 0).all()


@pytest.mark.parametrize(("mode", "masks"), [("omniscient", 36), ("masked", 0)])
def test_what_is_observed_changes_from_the_next_step_on(mode: str, masks: int) -> None:
    other = "masked" if mode == "omniscient" else "omniscient"
    env = outlast.make_vec("teams_3", 3, seed=1, cameras_mode=other, cameras_depth=0.01)
    env.reset()
    env.set_numbers(cameras_mode=mode)
    assert env.step(np.tile(env.noop, (3, 4, 1)))[0]["others_mask"].sum() == masks


@pytest.mark.parametrize(
    ("numbers", "wrong"),
    [
        ({"rewards_kil": 1}, "no number 'rewards_kil'; did you mean rewards_kill"),
        ({"inventory_slots": 5}, r"inventory_slots cannot change .*Inventory.dims\(\) reads it.* make new worlds"),
        ({"n_agents": 3}, "agents_count cannot change while worlds run: it is part of the initial state of episodes"),
        ({"room_size": 30.0}, "room_size cannot change while worlds run"),
        ({"death_drop_radius": 3.0}, "death_drop_radius cannot change while worlds run: .* bounds of observations"),
        ({"safe_zone_radii": (9.0,) * 7}, "safe_zone_radii cannot change .* single number|bounds of observations"),
        ({"melee_damage": -1}, "melee.damage = -1: must be >= 0"),
        ({"mortality_limit": 1}, "mortality.limit = 1: agents begin with 100"),
    ],
)
def test_what_cannot_change_is_refused(numbers: dict[str, Any], wrong: str) -> None:
    env = outlast.make_vec("ffa_2", 1, seed=1)
    with pytest.raises(NumberError, match=wrong):
        env.set_numbers(rewards_alive=9.0, **numbers)
    assert not env.worlds.changed  # not the number that was right, either


def test_recordings_have_the_numbers_of_their_scenario(tmp_path: Path) -> None:
    env = outlast.make_vec("ffa_2", 1, seed=1)
    env.set_numbers(rewards_kill=3)
    with pytest.raises(RecordingError, match=r"rewards_kill changed by set_numbers"):
        outlast.record(env, tmp_path / "a.outlast")
    env.set_numbers(rewards_kill=0.0)
    with outlast.record(env, tmp_path / "a.outlast"), pytest.raises(RecordingError, match="a recording goes on"):
        env.set_numbers(rewards_kill=3)
