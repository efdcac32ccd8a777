"""PettingZoo: which agents are reported when, what is done with actions, the state, and bad input."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import ScenarioError
from outlast.components import Health
from outlast.ecs import Clock, Entity, NumberError
from outlast.envs.errors import ActionError, ClosedError, NotResetError, StateError
from outlast.systems import Respawn
from tests.adapters.test_parallel import Env, act, both, play, same, short
from tests.conftest import digest, scaled

IDLE = [1, 1, 1, 0, 0, 0]


# ---- which agents are reported


def test_the_dead_are_reported_once_and_leave() -> None:
    """With terminated True, their last reward, and masks of 0."""
    env = short("ffa_3", seed=2)
    env.reset()
    ends: dict[str, int] = {}
    for tick, (before, (observations, rewards, terminated, truncated, infos)) in enumerate(play(env)):
        for part in (observations, rewards, terminated, truncated, infos):
            assert list(part) == before
        for agent in before:
            if terminated[agent]:
                assert agent not in ends
                ends[agent] = tick
                assert agent not in env.agents
            if not infos[agent]["alive"]:
                assert terminated[agent]
                assert observations[agent]["heals_mask"].sum() == 0
    assert ends.keys() == set(env.possible_agents)
    assert len(set(ends.values())) > 1


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


def test_kept_agents_stay_until_the_world_ends() -> None:
    """And are paid what the dead are paid: -1 a tick in this variant, or their team's reward."""
    env = short("ffa_3", dead="keep", seed=2)
    env.reset()
    paid = []
    for before, (_, rewards, terminated, _, infos) in play(env):
        assert before == env.possible_agents
        assert set(terminated.values()) == {not env.agents}
        paid += [rewards[agent] for agent in before if not infos[agent]["alive"]]
    assert len(paid) > 4
    assert set(paid) == {-1.0}


def limited(dead: str, seed: int) -> Any:
    """The step at the limit, in which those outside of the zone die; the world may end by its rule in that step."""
    env = outlast.parallel_env("teams_3", dead=dead, max_cycles=12, agents_health=11, safe_zone_radii=(8.0,))
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


def test_everything_returned_is_new() -> None:
    env = short(seed=1)
    observations, infos = env.reset()
    assert infos == {agent: {"alive": 1} for agent in env.possible_agents}
    kept = {agent: {key: values.copy() for key, values in seen.items()} for agent, seen in observations.items()}
    later, *_, next_infos = env.step(act(env, 0))
    assert same(observations, kept)
    for agent, seen in later.items():
        infos[agent]["alive"] = 7
        assert next_infos[agent] == {"alive": 1}
        for key, values in seen.items():
            assert not np.shares_memory(values, observations[agent][key])
            assert not np.shares_memory(values, env.base_env.observe()[key])
            values[:] = 7
    reference = short(seed=1)
    reference.reset()
    reference.step(act(reference, 0))
    assert same(env.step(act(env, 1)), reference.step(act(reference, 1)))


# ---- actions


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
    game, seen = game.replace(ending_limit=scaled(200, least=60), agents_health=3), 0
    env, batch = outlast.parallel_env(game, dead="keep"), outlast.make_vec(game, 1)
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


@pytest.mark.parametrize("kind", [list, tuple, np.int8, np.uint8, np.int32, np.uint64])
def test_actions_of_every_integer_type_mean_the_same(kind: Any) -> None:
    env, reference = short(seed=3), short(seed=3)
    env.reset()
    reference.reset()
    changed = {a: kind(v.tolist()) if kind in (list, tuple) else v.astype(kind) for a, v in act(env, 0).items()}
    assert same(env.step(changed), reference.step(act(reference, 0)))


def one(action: Any) -> Callable[[Env], Any]:
    return lambda env: env.step({"agent_0": IDLE, "agent_2": action})


REFUSED: dict[str, tuple[Callable[[Env], Any], type[Exception], str]] = {
    "too high": (one([1, 1, 1, 0, 0, 2]), ActionError, r"action 5 \(give\) of agent_2 is 2: 0 to 1 is allowed"),
    "below zero": (one([-1, 1, 1, 0, 0, 0]), ActionError, r"action 0 \(ahead\) of agent_2 is -1: 0 to 2 is allowed"),
    "far too high": (one(np.full(6, 2**64 - 1, np.uint64)), ActionError, f"of agent_2 is {2**64 - 1}: 0 to 2"),
    "wraps around": (one([256, 1, 1, 0, 0, 0]), ActionError, r"action 0 \(ahead\) of agent_2 is 256"),
    "one too few": (one([1, 1, 1, 0, 0]), ActionError, r"of agent_2 have shape \(5,\): \(actions,\) = \(6,\)"),
    "a row too many": (one([IDLE]), ActionError, r"of agent_2 have shape \(1, 6\): \(actions,\) = \(6,\)"),
    "floats": (one(np.ones(6)), ActionError, "of agent_2 are float64: integers are needed"),
    "truth values": (one([True] * 6), ActionError, "of agent_2 are bool: integers are needed"),
    "NaN": (one([np.nan] * 6), ActionError, "of agent_2 are float64: integers are needed"),
    "a string": (one("attack"), ActionError, r"of agent_2 have shape \(\): \(actions,\) = \(6,\)"),
    "None": (one(None), ActionError, r"of agent_2 have shape \(\): \(actions,\) = \(6,\)"),
    "unequal lists": (one([[1], [1, 2]]), ActionError, r"of agent_2 have shape \(2,\): \(actions,\) = \(6,\)"),
    "an unknown agent": (
        lambda env: env.step({"agent_4": IDLE}), ActionError, "no agent 'agent_4' to act; there are: agent_0, .*agent_3"
    ),
    "a number for an agent": (lambda env: env.step({0: IDLE}), ActionError, "no agent 0"),  # type: ignore[dict-item]
    "a list": (lambda env: env.step([IDLE] * 4), ActionError, "a dict of agent -> action"),  # type: ignore[arg-type]
    "no actions": (lambda env: env.step(None), ActionError, "actions are None"),  # type: ignore[arg-type]
    "seed below zero": (lambda env: env.reset(seed=-1), ValueError, "seed = -1"),
    "seed a float": (lambda env: env.reset(seed=1.5), ValueError, "seed = 1.5"),  # type: ignore[arg-type]
    "two seeds": (lambda env: env.reset(seed=[1, 2]), ValueError, "one integer"),  # type: ignore[arg-type]
    "space of no agent": (lambda env: env.observation_space("x"), KeyError, "no agent 'x'; there are: agent_0"),
    "actions of no agent": (lambda env: env.action_space("x"), KeyError, "no agent 'x'; there are: agent_0"),
    "no render mode": (lambda env: env.render(), ValueError, "render_mode: rgb_array, ansi, human"),
    "another scenario": (
        lambda env: env.set_state(short("ffa_3").get_state()), StateError, "another scenario"
    ),
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


@pytest.mark.parametrize("options", [{"options": 1}, {"reset_mask": "x"}, {}])
def test_reset_options_are_tolerated(options: dict[str, Any]) -> None:
    env, reference = short(seed=6), short(seed=6)
    assert same(env.reset(options=options), reference.reset())


@pytest.mark.parametrize("form", [{}, {"actions": "joint", "observations": "flat"}], ids=["dict", "flat"])
@pytest.mark.parametrize("dead", ["end", "keep"])
def test_masks_are_where_classic_games_have_them(dead: str, form: dict[str, Any]) -> None:
    """In observations that are otherwise the same, of every agent that is reported, and not in infos."""
    plain = short("teams_3", dead=dead, action_masks=True, **form)
    env = short("teams_3", dead=dead, action_masks="observation", **form)
    expected, infos = plain.reset(seed=3)
    found, more = env.reset(seed=3)
    for i, agent in enumerate(plain.possible_agents):
        plain.action_space(agent).seed(i)
    for tick in range(scaled(60, least=10)):
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


def test_calls_out_of_order() -> None:
    env = short(render_mode="ansi")
    assert (env.agents, env.num_agents, env.max_num_agents) == ([], 0, 4)
    for call in (lambda: env.step({}), env.state, env.action_masks, env.render):
        with pytest.raises(NotResetError, match=r"reset\(\)"):
            call()
    env.reset()
    list(play(env))
    with pytest.raises(NotResetError, match=r"episode is over.*reset\(\)"):
        env.step(dict.fromkeys(env.possible_agents, 0))
    assert env.state_space.contains(env.state())  # the end can be looked at
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step({}), env.state, env.render, env.get_state, env.action_masks):
        with pytest.raises(ClosedError, match="closed"):
            call()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"dead": "bury"}, ValueError, "dead = 'bury': allowed are 'end', 'keep'"),
        ({"dead": None}, ValueError, "dead = None: allowed are 'end', 'keep'"),
        ({"render_mode": "rgb"}, ValueError, "render_mode = 'rgb': allowed are None, 'rgb_array', 'ansi', 'human'"),
        ({"action_masks": "infos"}, ValueError, "action_masks = 'infos': allowed are 'observation', True and False"),
        ({"action_masks": "observation", "actions": "continuous"}, ValueError, "there are no action masks"),
        ({"seed": -3}, ValueError, "seed = -3"),
        ({"seed": "x"}, ValueError, "seed = 'x'"),
        ({"max_cycles": 0}, ValueError, "max_cycles = 0: an integer >= 1"),
        ({"max_cycles": 2.5}, ValueError, "max_cycles = 2.5: an integer >= 1"),
        ({"max_cycles": True}, ValueError, "max_cycles = True: an integer >= 1"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps = 0: an integer >= 1"),
        ({"max_cycles": 5, "ending_limit": 5}, ValueError, "the same number"),
        ({"max_episode_steps": 5, "ending_limit": 5}, ValueError, "the same number"),
        ({"max_cycles": 5, "max_episode_steps": 5}, ValueError, "the same number"),
        ({"scenario": 3}, ScenarioError, "3: a Scenario or the name of one"),
        ({"scenario": None, "melee_damage": 3}, ScenarioError, "None: a Scenario or the name of one"),
        ({"n_agents": 0}, NumberError, "agents.count = 0"),
    ],
)
def test_what_cannot_be_made(options: dict[str, Any], error: type[Exception], message: str) -> None:
    for make in (outlast.parallel_env, outlast.aec_env):
        with pytest.raises(error, match=message):
            make(**options)


@pytest.mark.parametrize("wrong", [[5, 1, 1, 0, 0, 0], [0.5] * 6, [1, 1], None])
def test_a_refused_action_leaves_the_turn_with_its_agent(wrong: Any) -> None:
    """Not with the last agent of the tick, whose turn could then never be taken."""
    env = outlast.aec_env("ffa_3", seed=0, n_agents=3)
    env.reset()
    for turn, agent in enumerate(env.possible_agents):
        with pytest.raises(ActionError, match=f"of {agent}"):
            env.step(wrong)
        assert (env.agent_selection, env.unwrapped.base_env.worlds[Clock].tick[0, 0]) == (agent, 0), turn
        env.step(IDLE)
    assert env.unwrapped.base_env.worlds[Clock].tick[0, 0] == 1


def test_no_turn_is_taken_in_a_closed_environment() -> None:
    env = outlast.aec_env("ffa_3", seed=0)
    env.reset()
    env.close()
    with pytest.raises(ClosedError, match="the environment is closed"):
        env.step(IDLE)
