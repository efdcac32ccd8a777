"""The ends of episodes: statistics, the time limit, and early stops. Autoreset in all modes: test_stateful.py."""

from typing import Any

import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.components import Phase, Side
from outlast.ecs import Clock, Entity, Read, Rows, Statistic, Write, column
from outlast.envs.errors import NotResetError
from tests.conftest import scaled
from tests.digests import numbered_actions
from tests.helpers.execution_modes import equal, short
from tests.helpers.mechanics import kind

WORLDS = scaled(40, least=4)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_statistics_are_those_of_the_episodes_that_ended(mode: str) -> None:
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
        assert "statistics_present" not in info  # all agents are in all episodes
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
                assert info["_final_obs"].tolist() == info["_final_info"].tolist() == done.tolist()
                assert [each is None for each in info["final_obs"]] == (~done).tolist()
            count += done.sum()
        length[done], returns[done] = 0, 0
        fresh = done if mode == "NextStep" else fresh
    assert count >= WORLDS
    assert {"heals_used", "boxes_placed", "kills"} < found.keys()


class Sizes(Statistic):
    tiny: Any = column("u1")
    short: Any = column("i2", "agents")
    harm: Any = column("i4", "damage_types")
    double: Any = column("f8", "agents")


Measures = kind("Measures", singletons=[Sizes()])


@Measures.system(Phase.ZONE)
def measure(sizes: Write[Sizes], clock: Read[Clock], agents: Rows[Side]) -> None:
    sizes.tiny[0] = tick = int(clock.tick[0])
    for k in range(sizes.harm.size):
        sizes.harm[k] = 100 * k + tick
    for k in range(agents.size):
        sizes.short[k], sizes.double[k] = -tick * (k + 1), tick / (k + 3)


def test_statistics_of_every_type_are_reported() -> None:
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


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_episodes_that_are_stopped_early_end_as_others_do(mode: str) -> None:
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
