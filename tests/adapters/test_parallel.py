"""PettingZoo: PettingZoo's own suites, and the same world as in the batched environment."""

import copy
import pickle
import sys
import warnings
from collections.abc import Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import VARIANTS, make_vec, variant
from outlast.ecs import Entity
from outlast.envs.core.agents import counts_vary, present
from outlast.envs.errors import NotResetError
from tests.conftest import COMPILED, few_by_day, scaled
from tests.helpers.execution_modes import ALL, COUNTS, EACH_LEVEL, HUNT, LEVELS, SHORT
from tests.helpers.execution_modes import short as scenario

pettingzoo = pytest.importorskip("pettingzoo", reason="needs pettingzoo: outlast[pettingzoo]")

from outlast.envs.adapters import pettingzoo as parallel  # noqa: E402

with warnings.catch_warnings():  # of PettingZoo, about its own examples
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import (
        api_test,
        max_cycles_test,
        parallel_api_test,
        parallel_seed_test,
        render_test,
        seed_test,
        state_test,
    )
    from pettingzoo.test.render_test import collect_render_results

CYCLES = scaled(1000, least=20)
NAMES = few_by_day(VARIANTS, ("ffa_1", "teams_3"))
both = pytest.mark.parametrize("dead", ["end", "keep"])
everywhere = pytest.mark.parametrize("name", [*NAMES, *(pytest.param(scenario(name), id=name) for name in (HUNT, ALL))])
Env = parallel.SurvivalParallelEnv


def short(name: str = "teams_3", **options: Any) -> Env:
    """Four agents, in teams or not, or up to four, and an early end."""
    if name in LEVELS:
        return outlast.parallel_env(scenario(name), **options)
    return outlast.parallel_env(name, **{"n_agents": 4, **SHORT, **options})


def act(env: Env, tick: int) -> dict[str, Any]:
    """Random actions of all agents, the dead included; they depend on the tick only."""
    rng = np.random.default_rng(tick)
    return {agent: rng.integers(0, env.action_space(agent).nvec) for agent in env.possible_agents}


def play(env: Env) -> Iterator[tuple[list[str], Any]]:
    """(the agents before the step, what the step returned) up to the end of the episode."""
    tick = 0
    while env.agents:
        yield list(env.agents), env.step(act(env, tick))
        tick += 1


def same(one: Any, other: Any) -> bool:
    """Whether dicts, lists and what is in them have the same types and the same values."""
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and bool(np.array_equal(one, other))


# ---- PettingZoo's own suites


@both
@everywhere
def test_parallel_api(name: str, dead: str) -> None:
    """Also its checks of dead agents, which are mere warnings; but for one, that some possible agents never played."""
    env = outlast.parallel_env(name, dead=dead, **SHORT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if counts_vary(env.base_env.worlds):
            warnings.filterwarnings("ignore", "No agents present but not all possible_agents are terminated")
        parallel_api_test(env, CYCLES)
    assert env.statistics or not COMPILED  # it saw the end of an episode


@both
@everywhere
@pytest.mark.filterwarnings("ignore:Observation is not a NumPy array", "ignore:.*probably should be gymnasium.spaces")
def test_aec_api(name: str, dead: str) -> None:
    env = outlast.aec_env(name, dead=dead, **SHORT)
    api_test(env, CYCLES)
    assert env.unwrapped.statistics or not COMPILED


@pytest.mark.parametrize("agents", [1, 12])
def test_other_numbers_of_agents(agents: int) -> None:
    """Agent 10 comes after agent 9, though its name sorts before."""
    env = outlast.parallel_env("ffa_1", **{**SHORT, "n_agents": agents})
    assert env.possible_agents == [f"agent_{i}" for i in range(agents)]
    parallel_api_test(env, CYCLES)
    observations, _ = env.reset()
    assert [seen["own"][0] for seen in observations.values()] == list(range(agents))
    assert list(env.step({})[0]) == env.agents == env.possible_agents


@both
@everywhere
def test_seeds(name: str, dead: str) -> None:
    parallel_seed_test(lambda: outlast.parallel_env(name, dead=dead, **SHORT), CYCLES)
    seed_test(lambda: outlast.aec_env(name, dead=dead, **SHORT), CYCLES)


def test_max_cycles() -> None:
    max_cycles_test(parallel)


def test_a_step_without_agents_and_actions_is_empty() -> None:
    """As in PettingZoo's own environments: SuperSuit's black_death goes on stepping when the last agent is gone."""
    env = outlast.parallel_env("ffa_2", max_episode_steps=2)
    with pytest.raises(NotResetError, match="the episode is over or has not begun"):
        env.step({})
    env.reset(seed=0)
    while env.agents:
        env.step({})
    assert env.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(NotResetError, match="the episode is over or has not begun"):
        env.step({"agent_0": env.action_space("agent_0").sample()})


@pytest.mark.parametrize("name", EACH_LEVEL)
def test_max_cycles_of_levels(name: str) -> None:
    """Nobody dies before; of the agents' numbers of steps it takes the median, so most have to be there."""
    level = scenario(name).replace(agents_health=1000)
    if name in (COUNTS, ALL):
        level = level.vary(n_agents=outlast.integers(3, 4))
    makers = {kind: partial(getattr(parallel, kind), level) for kind in ("env", "parallel_env")}
    max_cycles_test(SimpleNamespace(__name__=name, **makers))


@everywhere
@pytest.mark.filterwarnings("ignore:Environment's (minimum|maximum) state space value is -?infinity")
def test_state(name: str) -> None:
    """It takes infinite bounds for probably wrong ones; velocities, angles and health have no others."""
    state_test(outlast.aec_env(name, **SHORT), outlast.parallel_env(name, **SHORT), CYCLES)


@pytest.mark.parametrize("name", ["ffa_3", "teams_3", *EACH_LEVEL])
def test_render(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame", reason="render_mode='human' needs pygame, which is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    render_test(lambda **options: outlast.aec_env(scenario(name), **options))


@pytest.mark.parametrize("name", ["ffa_3", "teams_3", *EACH_LEVEL])
def test_render_without_a_window(name: str) -> None:
    """What their suite asks of pictures and text; drawing changes nothing."""
    for picture in collect_render_results(outlast.aec_env(scenario(name), render_mode="rgb_array")):
        assert (picture.dtype, picture.ndim, picture.shape[2]) == (np.uint8, 3, 3)
    pages = collect_render_results(outlast.aec_env(scenario(name), render_mode="ansi"))
    assert all(isinstance(page, str) for page in pages)
    drawn, blind = short(name, render_mode="rgb_array", seed=1), short(name, seed=1)
    assert same(drawn.reset(), blind.reset())
    assert np.array_equal(drawn.render(), drawn.render())
    assert same(drawn.step(act(drawn, 0)), blind.step(act(blind, 0)))


def test_a_window_needs_pygame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'outlast\[window\]'"):
        outlast.parallel_env(render_mode="human")


# ---- PettingZoo's registry


@pytest.mark.skipif(not hasattr(pettingzoo, "parallel_registry"), reason="a PettingZoo without a registry")
@pytest.mark.parametrize("kind", ["parallel", "aec"])
@pytest.mark.parametrize("name", NAMES)
def test_the_registry_makes_them(kind: Any, name: str) -> None:
    env = pettingzoo.make(kind, f"outlast/{name}-v1", max_cycles=7, melee_damage=2)
    assert isinstance(env, pettingzoo.ParallelEnv if kind == "parallel" else pettingzoo.AECEnv)
    scenario = env.unwrapped.base_env.scenario
    expected = variant(name).replace(ending_limit=7, melee_damage=2)
    assert (scenario.name, str(env)) == (expected.name, expected.name)
    assert scenario.numbers() == expected.numbers()


# ---- the same world as in a batch


@both
@pytest.mark.parametrize("name", ["ffa_3", "teams_3", *EACH_LEVEL])
def test_it_is_a_world_of_a_batch(name: str, dead: str) -> None:
    """Observations, rewards, ends and statistics of an episode with deaths; the batch also gets actions of the dead.

    Whom the episode does not have is in nothing that comes out.
    """
    env, seed = short(name, dead=dead), 5
    batch = make_vec(env.base_env.scenario, 3, seed=0)
    observations, _ = env.reset(seed=seed)
    expected, _ = batch.reset(seed=[seed + 1, seed, seed + 2])
    alive = batch.worlds[Entity].alive[1, batch.worlds.span("agent")]
    there = present(batch.worlds, 1)
    assert same(
        observations,
        {f"agent_{i}": {key: expected[key][1, i] for key in expected} for i in range(4) if there[i] or dead == "keep"},
    )
    died = done = False
    for tick, (before, (observations, rewards, terminated, truncated, infos)) in enumerate(play(env)):
        rows = [int(agent[6:]) for agent in before]
        actions = np.stack([list(act(env, tick).values())] * 3)
        expected, reward, ended, cut, info = batch.step(actions)
        gone = alive == 0 if dead == "end" else np.zeros(4, bool)
        done = bool(ended[1] | cut[1])
        died |= not alive[there].all() and not done
        assert same(observations, {f"agent_{i}": {key: expected[key][1, i] for key in expected} for i in rows})
        assert same(rewards, {f"agent_{i}": float(reward[1, i]) for i in rows})
        assert same(terminated, {f"agent_{i}": bool(ended[1] | gone[i]) for i in rows})
        assert same(truncated, {f"agent_{i}": bool(cut[1]) for i in rows})
        varying = {i: {"present": int(there[i])} if counts_vary(batch.worlds) else {} for i in rows}
        assert same(infos, {f"agent_{i}": {"alive": int(alive[i]), **varying[i]} for i in rows})
        assert env.agents == [agent for agent in before if not done and not gone[int(agent[6:])]]
    assert died or there.sum() < 3  # with one on each side, a death is the end
    assert done
    assert same(env.statistics, {key: values[1] for key, values in info["statistics"].items()})


def test_statistics_where_all_leave_a_world_that_goes_on() -> None:
    """They are of the last death, and of no episode before."""
    numbers = {"ending_rule": "never", "safe_zone_radii": (1.0,), "safe_zone_stand": 1000, "agents_health": 2}
    env = outlast.parallel_env("ffa_2", dead="end", seed=1, ending_limit=60, **numbers)
    batch = make_vec("ffa_2", 1, seed=1, ending_limit=60, **numbers)
    batch.reset()
    for _ in range(2):
        env.reset()
        ticks, returns = 0, np.zeros(2)
        while env.agents:
            env.step({})
            _, reward, *_ = batch.step(np.tile(batch.noop, (1, 2, 1)))
            ticks, returns = ticks + 1, returns + reward[0]
        assert ticks < 60
        assert env.statistics["length"] == ticks
        np.testing.assert_allclose(env.statistics["return"], returns, rtol=1e-6)
        batch.reset()


@both
def test_whole_episodes_repeat(dead: str) -> None:
    """Two in a row; reset() without a seed goes on to the next one, which is another."""
    one, other = short(dead=dead), short(dead=dead, seed=9)
    first, again = [one.reset(seed=9), *play(one)], [other.reset(), *play(other)]
    second, then = [one.reset(), *play(one)], [other.reset(), *play(other)]
    assert same(first, again)
    assert same(second, then)
    assert not same(first[0], second[0])
    assert same(first, [other.reset(seed=9), *play(other)])


@both
@pytest.mark.parametrize("name", [*NAMES, *EACH_LEVEL])
def test_everything_lies_in_its_space(name: str, dead: str) -> None:
    env = short(name, dead=dead, seed=1)
    observations, _ = env.reset()
    assert observations.keys() == {*env.possible_agents} or name in LEVELS
    count = present(env.base_env.worlds, 0).sum() if dead == "end" else None
    assert list(observations) == env.agents == env.possible_agents[:count]
    for _, (observations, rewards, terminated, truncated, _) in play(env):
        for agent, seen in observations.items():
            assert env.observation_space(agent).contains(seen)
            assert type(rewards[agent]) is float
            assert type(terminated[agent]) is type(truncated[agent]) is bool
        assert env.state_space.contains(env.state())
        assert np.isfinite(env.state()).all()
    for agent in env.possible_agents:
        space: Any = env.observation_space(agent)
        assert space is env.observation_space(agent)
        assert env.action_space(agent) is env.action_space(agent)
        assert env.action_space(agent).nvec.tolist() == [3, 3, 3, 2, 2, 2]
        assert all(box.dtype == np.float32 for box in space.values())
    assert env.action_space("agent_0") is not env.action_space("agent_1")  # they are seeded one by one


def test_every_count_of_agents_is_played() -> None:
    """Over the episodes of one environment; a state of another count goes on with its agents. Or all are kept."""
    env, found, states = short(COUNTS, seed=0), set(), {}
    for _ in range(20):
        observations, _ = env.reset()
        found.add(len(observations))
        states[len(observations)] = env.get_state()
        list(play(env))
    assert found == {2, 3, 4}
    for count, state in states.items():
        assert list(env.set_state(state)) == env.agents == env.possible_agents[:count]
        kept = short(COUNTS, dead="keep")
        assert list(kept.set_state(state)) == kept.agents == kept.possible_agents
        _, rewards, _, _, infos = kept.step(act(kept, 0))
        assert [info["present"] for info in infos.values()] == [1] * count + [0] * (4 - count)
        assert not any(list(rewards.values())[count:])


def test_copies_go_on_from_where_an_environment_is() -> None:
    env = short(dead="keep", render_mode="ansi")
    assert copy.deepcopy(env).agents == []
    env.reset()
    env.step({})
    env.base_env.set_numbers(motors_ahead=1.0)
    env.statistics = {"return": np.ones(2)}
    for name in env.agents:
        env.action_space(name).seed(3)
    other = copy.deepcopy(env)
    assert other.statistics["return"].tolist() == [1, 1]
    assert (other.dead, other.render_mode, other.agents) == ("keep", "ansi", env.agents)
    for _ in range(3):
        one, two = ({name: each.action_space(name).sample() for name in each.agents} for each in (other, env))
        assert same(other.step(one), env.step(two))
    assert same(other.reset(), env.reset())


def test_pickles_are_made_the_same_way() -> None:
    env = short(dead="keep", render_mode="ansi", seed=4)
    first = env.reset()
    env.step({})
    other = pickle.loads(pickle.dumps(env))
    assert (other.dead, other.render_mode, other.agents) == ("keep", "ansi", [])
    assert other.base_env.scenario == env.base_env.scenario
    assert same(other.reset(), first)
    assert pickle.loads(pickle.dumps(outlast.aec_env("ffa_3"))).metadata["name"] == "ffa_3"
