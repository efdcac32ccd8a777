"""Policies with a memory are told where episodes begin."""

import importlib.util
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import outlast
from outlast.ecs import Clock
from outlast.envs.errors import UsageError
from outlast.envs.rollout.local import rollout, ticks
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import scaled
from tests.helpers.execution_modes import short
from tests.helpers.remembering import Remembering

WORLDS, STEPS = scaled(13, least=3), scaled(160, least=28)


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_policy_with_a_memory_is_told_where_episodes_begin(mode: AutoresetMode) -> None:
    """Called once a tick, it has been called since as often as the clock says; also after resets of some worlds."""
    env, policy = outlast.make_vec(short("ffa_3"), WORLDS, seed=3, autoreset_mode=mode), Remembering()
    act, clock = told(policy, env), env.worlds[Clock]
    observations, _ = env.reset()
    for tick in range(STEPS):
        actions = act(observations)
        assert policy.calls is not None
        assert policy.calls.tolist() == clock.tick[:, 0].tolist()
        observations, _, terminated, truncated, _ = env.step(actions)
        some = np.arange(WORLDS) == tick % (3 * WORLDS)
        if mode is AutoresetMode.DISABLED:
            some |= terminated | truncated
        if some.any():
            observations, _ = env.reset(options={"reset_mask": some})
    assert clock.episode.min() >= 1
    assert [where.all() for where in policy.told[:2]] == [True, False]


def test_a_policy_with_a_memory_is_told_of_states() -> None:
    """Also of one of the very tick that it would have gone on to, and of the same episode begun again."""
    env, policy = outlast.make_vec(short("ffa_3"), 3, seed=3), Remembering()
    act, observations = told(policy, env), env.reset()[0]
    for _ in range(4):
        observations, *_ = env.step(act(observations))
    act(env.set_state(env.get_state([1]), [1]))
    assert policy.told[-1].tolist() == [False, True, False]
    assert policy.calls is not None
    assert policy.calls.tolist() == [4, 0, 4]
    for _ in range(2):
        act(env.reset(seed=3)[0])
        assert policy.told[-1].all()
    before = len(policy.told)
    env.step(act(env.reset(seed=3)[0]))
    act(env.observe())
    assert len(policy.told) == before + 1


def test_a_policy_without_a_memory_is_itself() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0)
    policy = POLICIES["noop"](env, 0)
    assert told(policy, env) is policy


def test_the_name_of_a_policy_is_no_policy() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0)
    for play in (told, lambda policy, env: next(ticks(env, policy, 3))):
        with pytest.raises(UsageError, match="policy = 'noop': a function is needed, such as"):
            play("noop", env)


def test_rollouts_tell_a_policy_where_episodes_begin() -> None:
    env, policy = outlast.make_vec(short("ffa_3"), WORLDS, seed=3), Remembering()
    seen = []

    def check(where: Any) -> None:
        if policy.calls is not None:  # the step of a world that restarts is at tick 0
            seen.append(np.where(env.worlds[Clock].tick[:, 0], policy.calls + 1, 0) == env.worlds[Clock].tick[:, 0])

    rollout(env, policy, STEPS, watch=check)
    assert np.all(seen)
    assert len(policy.told) > 1
    other = Remembering()
    for _ in ticks(env, other, 30):
        pass
    assert other.told[0].all()


class Keeps:
    """A policy that keeps what it saw, and counts how often that has become what it sees now."""

    def __init__(self) -> None:
        self.before: Any = None
        self.calls = self.changed = 0

    def __call__(self, observations: Any) -> Any:
        own = observations["own"]
        self.calls += 1
        self.changed += self.before is not None and np.array_equal(self.before, own)
        self.before = own
        return np.tile([2, 1, 2, 1, 0, 0], (*own.shape[:2], 1))  # turns as it goes


def test_policies_may_keep_what_they_see() -> None:
    mine, others, evaluated = Keeps(), Keeps(), Keeps()
    outlast.rollout("ffa_2", mine, worlds=2, steps=10)
    env = gymnasium.make_vec("outlast/FreeForAll2-v1", num_envs=2, others=others)
    env.reset(seed=0)
    for _ in range(10):
        env.step(np.zeros((2, 6), int))
    if importlib.util.find_spec("torch"):
        outlast.evaluate("ffa_2", {"mine": evaluated, "noop": "noop"}, worlds=2, episodes=2, ending_limit=8, quiet=True)
        assert evaluated.calls > 8
    assert (mine.changed, others.changed, evaluated.changed) == (0, 0, 0)
    assert min(mine.calls, others.calls) >= 10


def test_a_memory_is_of_one_side() -> None:
    policy = Remembering()
    with pytest.raises(UsageError, match="plays twice, and has a memory"):
        outlast.rollout("ffa_2", policy, others=policy, worlds=2, steps=2)
    outlast.rollout("ffa_2", policy, others=Remembering(), worlds=2, steps=2)
    if importlib.util.find_spec("torch"):
        with pytest.raises(UsageError, match="plays twice, and has a memory"):
            outlast.evaluate("ffa_2", {"a": policy, "b": policy}, worlds=2, episodes=2, quiet=True)
