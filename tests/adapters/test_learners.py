"""A batch of learners, one in every world: beside Gymnasium's own vector of single environments."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import outlast
from outlast import variant
from outlast.ecs import Clock
from outlast.envs.adapters.gymnasium_learners import SurvivalLearnerVectorEnv
from outlast.envs.adapters.gymnasium_single import SurvivalEnv
from outlast.envs.errors import ActionError, NotResetError
from outlast.envs.rollout.lineup import Lineup
from outlast.envs.rollout.policies import noop_policy, scripted_policy
from tests.conftest import digest, few_by_day
from tests.helpers.execution_modes import ALL, COUNTS, HUNT, MAZE, ROLES, same, short
from tests.helpers.remembering import Remembering

WORLDS, SEED, STEPS = 8, 11, 65
MODES = list(AutoresetMode)


def by_id(observations: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Each agent walks another way, by number and health, and attacks."""
    me = observations["own"]
    actions = np.ones((*me.shape[:2], 6), np.int8)
    actions[..., 0] = (me[..., 0] + me[..., 2]) % 3
    return actions


CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "free for all": ("ffa_3", {}),
    "the last of a team": ("teams_3", {"learner": 3, "others": "scripted"}),
    "the last of three": (HUNT, {"learner": 3, "others": "scripted"}),
    "in the middle, to the end": ("teams_3", {"learner": 1, "dead": "keep"}),
    "a function": ("teams_3", {"learner": 2, "others": by_id}),
    "a mixture": ("teams_3", {"learner": 1, "others": "scripted:0.5,random:0.3,noop:0.2"}),
    "a mixture with a function": ("ffa_3", {"others": {by_id: 2, "random": 1}, "max_episode_steps": 20}),
    "other counts": (COUNTS, {"learner": 1}),
    "roles that are drawn": (ROLES, {"learner": 2, "others": "scripted", "dead": "keep"}),
    "a maze": (MAZE, {"learner": 3, "others": "scripted"}),
    "other counts, roles and a maze": (ALL, {"learner": 1, "others": "scripted:0.5,random:0.3,noop:0.2"}),
    "none moves, and time is short": ("teams_3", {"others": "noop", "max_episode_steps": 14}),
}
DAILY = ("the last of three", "in the middle, to the end", "a mixture with a function")
DAILY += ("other counts, roles and a maze", "none moves, and time is short")
alike = partial(same, typed=False)  # Gymnasium makes Python's numbers 64 bits wide


def single(name: str, max_episode_steps: int | None = None, **options: Any) -> Callable[[], gymnasium.Env[Any, Any]]:
    def make() -> gymnasium.Env[Any, Any]:
        env = SurvivalEnv(short(name), **options)
        return gymnasium.wrappers.TimeLimit(env, max_episode_steps) if max_episode_steps else env

    return make


def drawn(env: Any, tick: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(tick).integers(0, [3, 3, 3, 2, 2, 2], (env.num_envs, 6))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", few_by_day(CASES, DAILY))
@pytest.mark.by_day(5)
def test_it_is_gymnasiums_vector_of_single_environments(name: str, mode: AutoresetMode) -> None:
    """Bit for bit over several episodes, sub-environment i seeded SEED + i in both; infos and final ones, too."""
    kind, options = CASES[name]
    env = SurvivalLearnerVectorEnv(WORLDS, short(kind), autoreset_mode=mode, **options)
    oracle: Any = SyncVectorEnv([single(kind, **options)] * WORLDS, autoreset_mode=mode)
    assert env.single_observation_space == oracle.single_observation_space
    assert (env.observation_space, env.action_space) == (oracle.observation_space, oracle.action_space)
    assert env.metadata | {"render_modes": 0} == oracle.metadata | {"render_modes": 0}
    assert all(alike(*pair) for pair in zip(env.reset(seed=SEED), oracle.reset(seed=SEED), strict=True))
    ends, truncations = 0, 0
    for tick in range(STEPS):
        results = [each.step(drawn(env, tick)) for each in (env, oracle)]
        for mine, its in zip(*results, strict=True):
            assert alike(mine, its), tick
        done = results[0][2] | results[0][3]
        ends, truncations = ends + int(done.sum()), truncations + int(results[0][3].sum())
        if mode is AutoresetMode.DISABLED and done.any():
            with pytest.raises(NotResetError, match=rf"sub-environments \[{np.flatnonzero(done)[0]}"):
                env.step(drawn(env, tick))
            results = [each.reset(options={"reset_mask": done.copy()}) for each in (env, oracle)]
            assert all(alike(*pair) for pair in zip(*results, strict=True))
    assert ends >= WORLDS
    assert (truncations > 0) == ("max_episode_steps" in options)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("mixed", [False, True])
def test_others_with_a_memory_are_told_where_episodes_begin(mode: AutoresetMode, mixed: bool) -> None:
    """Called once a tick, they have been called since as often as the clock says; from a set state on, from 0."""
    policies = [Remembering() for _ in range(1 + mixed)]
    others = dict.fromkeys(policies, 1.0) if mixed else policies[0]
    env = SurvivalLearnerVectorEnv(WORLDS, short("teams_3"), learner=1, others=others, autoreset_mode=mode)
    env.reset(seed=SEED)
    clock, since = env.base_env.worlds[Clock], np.zeros(WORLDS, int)  # the tick of the last state that was set
    for tick in range(STEPS):
        before = clock.tick[:, 0].astype(int)
        since[before == 0] = 0
        _, _, terminated, truncated, _ = env.step(drawn(env, tick))
        for policy in policies:  # each is drawn in some world
            assert policy.calls is not None
            assert (policy.calls == before - since).all()
        if mode is AutoresetMode.DISABLED and (done := terminated | truncated).any():
            env.reset(options={"reset_mask": done})
        if tick == 20:
            state = env.get_state()
        elif tick == 30:
            env.set_state(state)
            since = clock.tick[:, 0].astype(int)
            env.reset(options={"reset_mask": np.arange(WORLDS) == 0})
    assert all(policy.told[0].all() and not policy.told[-1].all() for policy in policies)
    assert clock.episode.max() > 1


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_state_of_an_end_begins_the_next_episode(mode: str) -> None:
    """In the next step: of a learner that died, whose world had not ended by itself, as in the batch that it left."""
    ended = SurvivalLearnerVectorEnv(WORLDS, short("teams_3"), autoreset_mode="Disabled")
    ended.reset(seed=SEED)
    done, tick = np.zeros(WORLDS, bool), 0
    while not done.any():
        _, _, terminated, truncated, _ = ended.step(drawn(ended, tick))
        done, tick = terminated | truncated, tick + 1
    env = SurvivalLearnerVectorEnv(WORLDS, short("teams_3"), autoreset_mode=mode)
    env.reset(seed=0)
    env.set_state(ended.get_state())
    before = env.base_env.worlds[Clock].episode[:, 0].copy()
    seen, rewards, *_ = env.step(drawn(env, tick))
    assert (env.base_env.worlds[Clock].episode[:, 0] - before).tolist() == done.astype(int).tolist()
    assert not rewards[done].any()
    start, _ = ended.reset(options={"reset_mask": done})
    assert all(np.array_equal(seen[key][done], start[key][done]) for key in seen)


def test_random_others_do_the_same_whoever_learns() -> None:
    batch = outlast.make_vec("teams_3", 3, seed=0)
    batch.reset()
    by_learner = {learner: Lineup([("random", 1)], batch, learner).actions() for learner in range(4)}
    assert np.array_equal(by_learner[0][:, 1:], by_learner[1][:, 1:])
    assert np.array_equal(by_learner[3][:, 1], by_learner[2][:, 1])
    assert not np.array_equal(by_learner[0][0], by_learner[0][1])  # worlds differ
    batch.reset()
    assert not np.array_equal(by_learner[0], Lineup([("random", 1)], batch, 0).actions())  # and episodes


def test_others_of_the_names_are_the_policies() -> None:
    batch = outlast.make_vec("teams_3", 3, seed=0)
    observations, _ = batch.reset()
    for name, policy in (("noop", noop_policy(batch)), ("scripted", scripted_policy(batch))):
        for learner in range(4):
            expected = np.delete(policy(observations), learner, axis=1)
            assert np.array_equal(Lineup([(name, 1)], batch, learner).actions(), expected)


def test_a_learner_alone() -> None:
    env = SurvivalLearnerVectorEnv(2, variant("ffa_1").replace(n_agents=1), others=by_id)
    env.reset(seed=0)
    assert env.step(drawn(env, 0))[1].tolist() == [1, 1]


REFUSED: dict[str, tuple[Any, str]] = {
    "its own, too": (lambda seen: np.ones((2, 4, 6), int), r"others: .*\(2, 4, 6\).* = \(2, 3, 6\)"),
    "floats": (lambda seen: np.ones((2, 3, 6)), "others: .*float64"),
    "nothing": (lambda seen: None, r"others: .*shape \(\)"),
    "too high": (lambda seen: np.full((2, 3, 6), 2), r"others: action 3 \(attack\) of agent 0 in world 0 is 2"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_others_must_not_do(name: str) -> None:
    policy, message = REFUSED[name]
    env = SurvivalLearnerVectorEnv(2, short("teams_3"), learner=1, others=policy)
    env.reset(seed=SEED)
    before = digest(env.base_env.worlds)
    with pytest.raises(ActionError, match=message):
        env.step(drawn(env, 0))
    assert digest(env.base_env.worlds) == before
