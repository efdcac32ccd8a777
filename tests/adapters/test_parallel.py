"""PettingZoo: its own suites, the same world as in a batch, who is reported when, the state, and bad input."""

import copy
import sys
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import VARIANTS, make_vec, variant
from outlast.components import Bag, Body, Box, Health, SelfView, Shape, Wall
from outlast.ecs import Clock, Entity
from outlast.envs.core.observations import GlobalState
from outlast.envs.core.spaces import counts_vary, present
from outlast.envs.errors import ActionError, NotResetError, StateError
from outlast.systems import Respawn
from tests.conftest import digest, few_by_day
from tests.helpers.execution_modes import ALL, COUNTS, EACH_LEVEL, HUNT, LEVELS, MAZE, ROLES, SHORT, equal
from tests.helpers.execution_modes import short as scenario

pettingzoo = pytest.importorskip("pettingzoo", reason="needs pettingzoo: outlast[pettingzoo]")

from outlast.envs.adapters import pettingzoo as parallel  # noqa: E402

with warnings.catch_warnings():  # of PettingZoo, about its own examples
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import max_cycles_test, state_test

NAMES = few_by_day(VARIANTS, ("ffa_1", "teams_3"))
both = pytest.mark.parametrize("dead", ["end", "keep"])
everywhere = pytest.mark.parametrize("name", [*NAMES, *(pytest.param(scenario(name), id=name) for name in (HUNT, ALL))])
Env = parallel.SurvivalParallelEnv


def short(name: str = "teams_3", **options: Any) -> Env:
    """Four agents, in teams or not, or up to four, and an early end."""
    if name in LEVELS:
        return outlast.adapters.parallel_env(scenario(name), **options)
    return outlast.adapters.parallel_env(name, **{"n_agents": 4, **SHORT, **options})


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


@pytest.mark.parametrize("agents", [1, 12])
def test_other_numbers_of_agents(agents: int) -> None:
    env = outlast.adapters.parallel_env("ffa_1", **{**SHORT, "n_agents": agents})
    assert env.possible_agents == [f"agent_{i}" for i in range(agents)]
    observations, _ = env.reset()
    assert [seen["own"][0] for seen in observations.values()] == list(range(agents))
    assert list(env.step({})[0]) == env.agents == env.possible_agents


def test_max_cycles() -> None:
    max_cycles_test(parallel)


def test_a_step_without_agents_and_actions_is_empty() -> None:
    """As in PettingZoo's own environments: SuperSuit's black_death goes on stepping when the last agent is gone."""
    env = outlast.adapters.parallel_env("ffa_2", max_episode_steps=2)
    with pytest.raises(NotResetError, match="the episode is over or has not begun"):
        env.step({})
    env.reset(seed=0)
    while env.agents:
        env.step({})
    assert env.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(NotResetError, match="the episode is over or has not begun"):
        env.step({"agent_0": env.action_space("agent_0").sample()})


@everywhere
@pytest.mark.filterwarnings("ignore:Environment's (minimum|maximum) state space value is -?infinity")
def test_state(name: str) -> None:
    """It takes infinite bounds for probably wrong ones; velocities, angles and health have no others."""
    state_test(outlast.adapters.aec_env(name, **SHORT), outlast.adapters.parallel_env(name, **SHORT), 1000)


def test_a_window_needs_pygame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'outlast\[window\]'"):
        outlast.adapters.parallel_env(render_mode="human")


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
    first = [i for i in range(4) if there[i] or dead == "keep"]
    assert same(observations, {f"agent_{i}": {key: expected[key][1, i] for key in expected} for i in first})
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
        if env.agents:
            masks = {agent: batch.action_masks()[1, int(agent[6:])] for agent in env.agents}
            assert equal(env.action_masks(), masks)
    assert died or there.sum() < 3  # with one on each side, a death is the end
    assert done
    assert same(env.statistics, {key: values[1] for key, values in info["statistics"].items()})


def test_statistics_where_all_leave_a_world_that_goes_on() -> None:
    numbers = {"ending_rule": "never", "safe_zone_radii": (1.0,), "safe_zone_stand": 1000, "agents_health": 2}
    env = outlast.adapters.parallel_env("ffa_2", dead="end", seed=1, ending_limit=60, **numbers)
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


IDLE = [1, 1, 1, 0, 0, 0]


def test_nobody_comes_back() -> None:
    """Whatever a mechanic does: an agent of PettingZoo has no second life within an episode."""
    env = short("ffa_3", seed=2)
    env.reset()
    while len(env.agents) == 4:
        env.step({})
    left = list(env.agents)
    worlds = env.base_env.worlds
    for column in (worlds[Entity].alive, worlds[Health].points):
        column[0, worlds.span("agent")] = 1
    observations, *_, infos = env.step({})
    assert list(observations) == list(infos) == left
    assert worlds[Entity].alive[0, worlds.span("agent")].all()
    assert env.agents == left
    assert env.reset()[0].keys() == set(env.possible_agents)


def limited(dead: str, seed: int) -> Any:
    """The step at the limit, in which those outside of the zone die; the world may end by its rule in that step."""
    env = outlast.adapters.parallel_env("teams_3", dead=dead, max_cycles=12, agents_health=11, safe_zone_radii=(8.0,))
    env.reset(seed=seed)
    *_, (_, last) = play(env)
    assert env.agents == []
    return env, last


@both
def test_at_the_limit_all_agents_are_truncated(dead: str) -> None:
    """Also those that die in that step. If the world ends by its rule, all are terminated and none is truncated."""
    found = set()
    for seed in range(12):
        env, (_, _, terminated, truncated, infos) = limited(dead, seed)
        alive = {agent: bool(info["alive"]) for agent, info in infos.items()}
        assert list(truncated) == env.possible_agents
        if not (any(alive[f"agent_{i}"] for i in (0, 1)) and any(alive[f"agent_{i}"] for i in (2, 3))):
            assert set(terminated.values()) == {True}
            assert set(truncated.values()) == {False}
            found.add("rule")
            continue
        assert set(truncated.values()) == {True}
        assert terminated == {agent: dead == "end" and not lives for agent, lives in alive.items()}
        found.add("limit and deaths" if not all(alive.values()) else "limit")
    assert {"rule", "limit and deaths"} <= found


@both
def test_the_dead_and_the_missing_idle(dead: str) -> None:
    """What the dead want is not even looked at; a random order of agents means nothing."""
    env, reference = short("ffa_3", dead=dead, seed=2), short("ffa_3", dead=dead, seed=2)
    env.reset()
    reference.reset()
    alive = env.base_env.worlds[Entity].alive[0, env.base_env.worlds.span("agent")]
    tick, nonsense = 0, 0
    while env.agents:
        actions = {**act(env, tick), "agent_1": IDLE}
        living = {agent: actions[agent] for i, agent in enumerate(env.possible_agents) if alive[i]}
        gone = {agent: "nonsense" for agent in env.possible_agents if agent not in living}
        living.pop("agent_1", None)
        assert same(env.step({**gone, **dict(reversed(living.items()))}), reference.step(actions))
        tick, nonsense = tick + 1, nonsense + len(gone)
    assert nonsense


def test_an_agent_acts_in_the_step_in_which_it_comes_back() -> None:
    game = outlast.variant("ffa_1").with_(Respawn(ticks=5)).replace(ending_rule="never", safe_zone_radii=(0.5,))
    game, seen = game.replace(ending_limit=200, agents_health=3), 0
    env, batch = outlast.adapters.parallel_env(game, dead="keep"), outlast.make_vec(game, 1)
    env.reset(seed=0)
    batch.reset(seed=0)
    rng = np.random.default_rng(0)
    while env.agents:
        actions = rng.integers(0, batch.action_sizes, (1, 2, len(batch.action_sizes)))
        actions[..., :3] = 2  # ahead, to the left, and around
        found = env.step(dict(zip(env.agents, actions[0], strict=True)))[0]
        expected = batch.step(actions)[0]["own"][0]
        if env.agents:  # else the batch has begun anew
            assert np.array_equal([found[agent]["own"] for agent in env.possible_agents], expected)
            seen += len(batch.events()["respawned"])
    assert seen


REFUSED: dict[str, tuple[Callable[[Env], Any], type[Exception], str]] = {
    "an unknown agent": (lambda env: env.step({"agent_4": IDLE}), ActionError, "no agent 'agent_4' to act; there are"),
    "a number for an agent": (lambda env: env.step({0: IDLE}), ActionError, "no agent 0"),  # type: ignore[dict-item]
    "a list": (lambda env: env.step([IDLE] * 4), ActionError, "a dict of agent -> action"),  # type: ignore[arg-type]
    "two seeds": (lambda env: env.reset(seed=[1, 2]), ValueError, "one integer"),  # type: ignore[arg-type]
    "actions of no agent": (lambda env: env.action_space("x"), KeyError, "no agent 'x'; there are: agent_0"),
    "no render mode": (lambda env: env.render(), ValueError, "render_mode: rgb_array, ansi, human"),
    "another scenario": (lambda env: env.set_state(short("ffa_3").get_state()), StateError, "another scenario"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_changes_nothing(name: str) -> None:
    call, error, message = REFUSED[name]
    env, reference = short(seed=6), short(seed=6)
    for each in (env, reference):
        each.reset()
        each.step(act(each, 0))
    before, agents = digest(env.base_env.worlds), list(env.agents)
    with pytest.raises(error, match=message) as raised:
        call(env)
    assert type(raised.value) is error
    assert (digest(env.base_env.worlds), env.agents) == (before, agents)
    assert same(env.step(act(env, 1)), reference.step(act(reference, 1)))


@pytest.mark.parametrize("form", [{}, {"actions": "joint", "observations": "flat"}], ids=["dict", "flat"])
@pytest.mark.parametrize("dead", ["end", "keep"])
def test_masks_are_where_classic_games_have_them(dead: str, form: dict[str, Any]) -> None:
    plain = short("teams_3", dead=dead, action_masks=True, **form)
    env = short("teams_3", dead=dead, action_masks="observation", **form)
    expected, infos = plain.reset(seed=3)
    found, more = env.reset(seed=3)
    for i, agent in enumerate(plain.possible_agents):
        plain.action_space(agent).seed(i)
    for tick in range(60):
        assert list(found) == list(expected)
        for agent, seen in found.items():
            assert env.observation_space(agent).contains(seen)
            assert same(seen["observation"], expected[agent])
            assert same(infos[agent], more[agent] | {"action_mask": seen["action_mask"]})
            assert "action_mask" not in more[agent]
        if not env.agents:
            break
        if tick == 5:
            assert same(env.set_state(env.get_state()), found)
            env = copy.deepcopy(env)
        actions = {agent: plain.action_space(agent).sample() for agent in env.agents}
        expected, *_, infos = plain.step(actions)
        found, *_, more = env.step(actions)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"action_masks": "infos"}, "action_masks = 'infos': allowed are 'observation', True and False"),
        ({"action_masks": "observation", "actions": "continuous"}, "masks exist for discrete actions"),
        ({"max_cycles": 2.5}, "max_cycles = 2.5: an integer >= 1"),
        ({"max_cycles": 5, "ending_limit": 5}, "the same number"),
        ({"max_cycles": 5, "max_episode_steps": 5}, "the same number"),
        ({"scenario": None, "melee_damage": 3}, "None: a Scenario or the name of one"),
    ],
)
def test_what_cannot_be_made(options: dict[str, Any], message: str) -> None:
    for make in (outlast.adapters.parallel_env, outlast.adapters.aec_env):
        with pytest.raises(ValueError, match=message):
            make(**options)


@pytest.mark.parametrize("wrong", [[5, 1, 1, 0, 0, 0], [0.5] * 6, [1, 1], None])
def test_a_refused_action_leaves_the_turn_with_its_agent(wrong: Any) -> None:
    env = outlast.adapters.aec_env("ffa_3", seed=0, n_agents=3)
    env.reset()
    for turn, agent in enumerate(env.possible_agents):
        with pytest.raises(ActionError, match=f"of {agent}"):
            env.step(wrong)
        assert (env.agent_selection, env.unwrapped.base_env.worlds[Clock].tick[0, 0]) == (agent, 0), turn
        env.step(IDLE)
    assert env.unwrapped.base_env.worlds[Clock].tick[0, 0] == 1


BUSY: dict[str, Any] = {  # items change hands all the time, and all agents observe everything
    "n_agents": 4, "agents_health": 100000, "cameras_mode": "omniscient", "pickup_reach": 5.0, "melee_reach": 6.0,
    "boxes_toughness": 1, "boxes_owned": False, "max_cycles": 200,
}  # fmt: skip


def blocks(state: Any, features: int, heals: int, boxes: int) -> list[Any]:
    """agents, zone, objects and items, as rows."""
    sizes = [4 * (1 + features), 6, boxes * 7, (boxes + heals) * 4]
    assert state.shape == (sum(sizes),)
    widths = [1 + features, 6, 7, 4]
    return [part.reshape(-1, k) for part, k in zip(np.split(state, np.cumsum(sizes)[:-1]), widths, strict=True)]


@pytest.mark.parametrize(("name", "features"), [("ffa_3", 8), ("teams_3", 9)])
def test_the_state_is_what_an_omniscient_observer_sees(name: str, features: int) -> None:
    env = outlast.adapters.parallel_env(name, **BUSY)
    seen = env.reset(seed=1)[0]["agent_0"]
    carried = broken = 0
    worlds = env.base_env.worlds
    for tick in range(100):
        state = env.state()
        assert state.dtype == np.float32
        agents, zone, objects, items = blocks(state, features, 15, 8)
        assert np.array_equal(agents[0], [1, *seen["own"]])
        assert np.array_equal(agents[1:, 1:], seen["others"])
        assert np.array_equal(agents[1:, 0], seen["others_mask"])
        assert np.array_equal(zone[0], seen["zone"])
        width, height, place = seen["boxes"][:, 2], seen["boxes"][:, 5], seen["boxes"][:, 8:]
        expected = [seen["boxes_mask"], *place.T, width, height]
        assert np.array_equal(objects[:, :6], np.column_stack(expected))
        hits = worlds[Health].points[0, worlds.layout.rows(Box)]
        assert np.array_equal(objects[:, 6], hits * seen["boxes_mask"])
        shown = np.concatenate([seen["box_items"][:, 8:], seen["heals"]])
        mask = np.concatenate([seen["box_items_mask"], seen["heals_mask"]])
        assert np.array_equal(items[:, :3], np.column_stack([mask, shown]))
        first = worlds.span("box_item").start
        bags = [{row - first for row in bag[bag >= 0]} for bag in worlds[Bag].items[0, worlds.span("agent")]]
        assert [set(np.flatnonzero(items[:, 3] == 1 + i)) for i in range(4)] == bags
        carried, broken = max(carried, (items[:, 3] > 0).sum()), max(broken, (objects[:, 0] == 0).sum())
        seen = env.step(act(env, tick))[0]["agent_0"]
    assert carried > 1
    assert broken > 0


def test_the_dead_are_not_alive_in_the_state() -> None:
    env = short("ffa_3", dead="keep", seed=2)
    env.reset()
    dead = 0
    for _, (*_, infos) in play(env):
        rows = env.state()[: 4 * 9].reshape(4, 9)
        assert rows[:, 0].tolist() == [info["alive"] for info in infos.values()]
        assert not rows[rows[:, 0] == 0, 2:].any()
        dead += (rows[:, 0] == 0).sum()
    assert dead


def test_the_state_has_walls_and_numbers() -> None:
    """Of the episode; walls that do not stand, and agents that are absent, are rows of 0."""
    env = short(ALL, dead="keep", seed=0)
    for _ in range(4):
        env.reset()
        worlds, state = env.base_env.worlds, env.state()
        numbers = ("agents_count", "boxes_count", "heals_count")
        assert state[-3:].tolist() == [env.base_env.numbers()[name][0] for name in numbers]
        rows = worlds.layout.rows(Wall)
        walls = state[-3 - 6 * len(rows) : -3].reshape(-1, 6)
        stand = worlds[Entity].alive[0, rows] != 0
        body, shape = worlds[Body], worlds[Shape]
        columns = [body.x, body.y, body.angle, shape.half_width, shape.half_height]
        assert np.array_equal(walls[stand, 1:], np.stack([column[0, rows] for column in columns], 1)[stand])
        assert walls[:, 0].tolist() == stand.tolist()
        assert stand.sum() > 0
        assert not walls[~stand].any()
        agents = state[: 4 * (1 + worlds[SelfView].own.shape[-1])].reshape(4, -1)
        assert not agents[~present(worlds, 0)].any()
        assert env.state_space.contains(state)


@both
@pytest.mark.parametrize("name", ["ffa_3", MAZE, ROLES])
def test_going_on_from_a_saved_state(name: str, dead: str) -> None:
    """In another environment, after a death; the state of one world of a batch will do as well."""
    env, other = short(name, dead=dead, seed=2), short(name, dead=dead, seed=77)
    _, infos = env.reset()
    while not env.agents or all(info["alive"] for info in infos.values()):
        *_, infos = env.step(act(env, 0)) if env.agents else env.reset()
    state, agents = env.get_state(), list(env.agents)
    assert len(agents) == 4 if dead == "keep" else 0 < len(agents) < 4
    expected = list(play(env))
    observations = other.set_state(state)
    assert list(observations) == other.agents == agents
    assert same(list(play(other)), expected)
    ended = env.get_state()
    env.reset()
    assert env.set_state(ended) == {}
    assert env.agents == []
    batch = outlast.make_vec(env.base_env.scenario, 3, seed=4)
    batch.reset()
    other.set_state(batch.get_state(2))
    own = batch.observe()["own"][2, 0]
    assert np.array_equal(other.state()[1 : 1 + len(own)], own)


@pytest.mark.parametrize("name", ["ffa_1", "ffa_3", "teams_3", "teams_3+steering"])
def test_scaled_states_are_about_minus_1_to_1(name: str) -> None:
    env = make_vec(name, 5, seed=1, copy=False)
    overview, found = GlobalState(env.worlds), []
    assert overview.scale.shape == overview.space.shape
    env.reset()
    for _ in range(200):
        env.step(env.action_space.sample())
        found.append(np.abs(overview(slice(None)) / overview.scale))
    most = np.max(found, axis=(0, 1))
    assert (most > 0.1).mean() > 0.5
    assert most.max() < 6
    assert (most > 2.5).mean() < 0.05
