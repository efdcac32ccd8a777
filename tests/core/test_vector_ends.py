"""The ends of episodes: autoreset in all modes, statistics, and the time limit."""

from typing import Any

import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.components import Phase, Side
from outlast.ecs import Clock, Entity, Module, Read, Rows, Singleton, Statistic, Write, column
from outlast.envs.errors import NotResetError
from tests.conftest import digest, scaled
from tests.digests import numbered_actions
from tests.helpers.execution_modes import equal, short

WORLDS = scaled(40, least=4)


def test_next_step_resets_in_a_step_of_its_own() -> None:
    """It ignores the actions, pays nothing, ends nothing, and shows the new episode."""
    env, other = make_vec(short("teams_3"), WORLDS, seed=0), make_vec(short("teams_3"), WORLDS, seed=0)
    env.reset()
    other.reset()
    done, resets = np.zeros(WORLDS, bool), 0
    for tick in range(80):
        actions = numbered_actions(env, tick)
        observations, reward, terminated, truncated, _ = env.step(actions)
        actions[done] = (actions[done] + 1) % 2
        other.step(actions)
        assert np.array_equal(env.worlds.block, other.worlds.block)
        assert not reward[done].any()
        assert not (terminated | truncated)[done].any()
        assert (env.worlds[Clock].tick[done] == 0).all()
        assert (observations["own"][done, :, 2] == 10).all()
        resets += done.sum()
        done = terminated | truncated
    assert resets >= WORLDS


def test_same_step_shows_both_episodes_at_once() -> None:
    """Beside NEXT_STEP: final_obs is the observation of its last step, and the observation that of its reset step."""
    same, following = (
        make_vec(short("teams_3"), WORLDS, seed=0, autoreset_mode=mode) for mode in ("SameStep", "NextStep")
    )
    same.reset()
    following.reset()
    done = np.zeros(1, bool)
    while not done.any():
        actions = numbered_actions(same, 0)
        observations, *outcome, info = same.step(actions)
        buffers, *expected, expected_info = following.step(actions)
        last = {key: values.copy() for key, values in buffers.items()}
        assert all(np.array_equal(mine, theirs) for mine, theirs in zip(outcome, expected, strict=True))
        done = outcome[1] | outcome[2]
    assert not done.all()
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == done.tolist()
    assert equal(info["final_info"]["statistics"], expected_info["statistics"])
    fresh, *_ = following.step(actions)
    for w in range(WORLDS):
        if done[w]:
            assert all(np.array_equal(info["final_obs"][w][key], last[key][w]) for key in last)
            assert all(np.array_equal(observations[key][w], fresh[key][w]) for key in fresh)
        else:
            assert info["final_obs"][w] is None
            assert all(np.array_equal(observations[key][w], last[key][w]) for key in last)
    assert (same.worlds[Clock].tick[done] == 0).all()
    same.step(actions)  # and on without a pause
    assert (same.worlds[Clock].tick[done] == 1).all()


def test_disabled_waits_for_a_reset_of_what_ended() -> None:
    env = make_vec(short("teams_3"), WORLDS, seed=0, autoreset_mode="Disabled")
    env.reset()
    for tick in range(80):
        _, _, terminated, truncated, _ = env.step(actions := numbered_actions(env, tick))
        if (done := terminated | truncated).any():
            break
    before = digest(env.worlds)
    with pytest.raises(NotResetError, match=rf"worlds \[{np.flatnonzero(done)[0]}.* have ended.*reset_mask"):
        env.step(actions)
    assert digest(env.worlds) == before
    others = digest(env.worlds, ~done)
    env.reset(options={"reset_mask": done})
    assert digest(env.worlds, ~done) == others
    env.step(actions)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_statistics_are_those_of_the_episodes_that_ended(mode: str) -> None:
    """Lengths and returns as counted here; rows of worlds that go on are zero."""
    env = make_vec(short("teams_3"), WORLDS, seed=0, autoreset_mode=mode)
    env.reset()
    length, returns, count = np.zeros(WORLDS, int), np.zeros((WORLDS, 4)), 0
    fresh = np.zeros(WORLDS, bool)
    for tick in range(80):
        _, reward, terminated, truncated, info = env.step(numbered_actions(env, tick))
        length += ~fresh
        returns += reward
        done = terminated | truncated
        assert np.array_equal(info["alive"], env.worlds[Entity].alive[:, env.worlds.span("agent")] == 1)
        assert ("statistics" in info) == done.any()
        if "statistics" in info:
            found = info["statistics"]
            assert info["_statistics"].tolist() == done.tolist()
            assert np.array_equal(found["length"], np.where(done, length, 0))
            assert np.array_equal(found["return"], np.where(done[:, None], returns, 0))
            dead = found["deaths_melee"] + found["deaths_zone"]
            assert (dead[done & terminated] >= 2).all()  # one team of two, or both
            assert (dead[~done] == 0).all()
            assert ((found["first_death"] <= found["length"]) | ~done).all()
            if mode == "SameStep":
                assert found is info["final_info"]["statistics"]
            count += done.sum()
        length[done], returns[done] = 0, 0
        fresh = done if mode == "NextStep" else fresh
    assert count >= WORLDS
    assert {"heals_used", "boxes_placed", "kills"} < found.keys()


class Sizes(Statistic):
    tiny: Any = column("u1")
    short: Any = column("i2", "agents")
    single: Any = column("f4")
    harm: Any = column("i4", "damage_types")
    long: Any = column("i8")
    double: Any = column("f8", "agents")


class Measures(Module):
    def singletons(self) -> list[Singleton]:
        return [Sizes()]


@Measures.system(Phase.ZONE)
def measure(sizes: Write[Sizes], clock: Read[Clock], agents: Rows[Side]) -> None:
    tick = int(clock.tick[0])
    sizes.tiny[0], sizes.single[0], sizes.long[0] = tick, np.float32(tick) / 4, -tick * 2**40
    for k in range(sizes.harm.size):
        sizes.harm[k] = 100 * k + tick
    for k in range(agents.size):
        sizes.short[k], sizes.double[k] = -tick * (k + 1), tick / (k + 3)


def test_statistics_of_every_type_are_reported() -> None:
    """One number, or one for each agent or type of damage, of 1 to 8 bytes."""
    env = make_vec(short("teams_3").with_(Measures()), WORLDS, seed=0)
    env.reset()
    k, ended = np.arange(4), 0
    for tick in range(60):
        *_, terminated, truncated, info = env.step(numbered_actions(env, tick))
        if not (done := terminated | truncated).any():
            continue
        found, length = info["statistics"], info["statistics"]["length"].astype(np.int64)
        expected = {
            "tiny": length.astype(np.uint8),
            "single": length / 4,
            "long": -length * 2**40,
            "harm_melee": length,
            "harm_zone": 100 + length,
            "short": -length[:, None] * (k + 1),
            "double": length[:, None] / (k + 3),
        }
        for key, values in expected.items():
            assert found[key].dtype == Sizes.columns[key.split("_")[0]].dtype
            assert np.array_equal(found[key], np.where(done if values.ndim == 1 else done[:, None], values, 0)), key
        ended += int(done.sum())
    assert ended >= WORLDS


def test_the_time_limit_truncates() -> None:
    """Exactly at the limit; a world that ends by its rule in that very tick is terminated instead."""
    scenario = variant("teams_3").replace(agents_health=11, safe_zone_radii=(8.0,))  # agents outside die in tick 12
    limited = make_vec(scenario.replace(ending_limit=12), scaled(200, least=16), seed=0)
    unlimited = make_vec(scenario, limited.num_worlds, seed=0)
    idle = np.tile([1, 1, 1, 0, 0, 0], (limited.num_worlds, 4, 1))
    limited.reset()
    unlimited.reset()
    for tick in range(1, 13):
        *_, terminated, truncated, _ = limited.step(idle)
        *_, ended, cut, _ = unlimited.step(idle)
        assert np.array_equal(terminated, ended)
        assert truncated.tolist() == (~terminated & (tick == 12)).tolist()
        assert not cut.any()
    assert terminated.any()
    assert truncated.any()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_episodes_that_are_stopped_early_end_as_others_do(mode: str) -> None:
    """Bit for bit those of a scenario that has the same limit."""
    scenario = variant("teams_3")
    limited = make_vec(scenario.replace(ending_limit=7), 3, seed=0, autoreset_mode=mode)
    env = make_vec(scenario, 3, seed=0, autoreset_mode=mode)
    env.stop_when(lambda: (np.zeros(3, bool), env.worlds[Clock].tick[:, 0] >= 7))
    for each in (env, limited):
        each.reset()
    for tick in range(20):
        actions = numbered_actions(env, tick)
        (_, *mine, info), (_, *theirs, expected) = env.step(actions), limited.step(actions)
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))
        assert info.keys() == expected.keys()
        assert "statistics" not in info or equal(info["statistics"], expected["statistics"])
        assert equal(env.observe(), limited.observe())
        if mode == "Disabled" and (done := mine[1] | mine[2]).any():
            with pytest.raises(NotResetError, match=r"worlds \[0, 1, 2\] have ended"):
                env.step(actions)
            for each in (env, limited):
                each.reset(options={"reset_mask": done})
    state = env.get_state()
    for _ in range(7):
        env.set_state(state)
        env.step(actions)
    assert env.get_state().arrays["over"].tolist() == [False] * 3  # the scenario's own ends, for those that load it
