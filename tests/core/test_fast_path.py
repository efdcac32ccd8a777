"""The fast path: steps in the background, observations in memory of the caller."""

from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import as_strided

import outlast
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import ActionError, ClosedError
from tests.conftest import COMPILED, digest, draw_actions
from tests.helpers.execution_modes import same

WORLDS, STEPS = 8, 40 if COMPILED else 4


def make(**options: Any) -> SurvivalVectorEnv:
    scenario = outlast.variant("ffa_3").replace(ending_limit=15 if COMPILED else 2)
    env = outlast.make_vec(scenario, **{"num_worlds": WORLDS, "seed": 1, "copy": False} | options)
    env.reset()
    return env


def test_two_halves_are_the_whole() -> None:
    whole, rng = make(), np.random.default_rng(0)
    halves = [make(num_worlds=WORLDS // 2, first_world=first) for first in (0, WORLDS // 2)]
    actions = [draw_actions(whole, rng) for _ in range(STEPS)]
    split = [np.split(both, 2) for both in actions]
    halves[0].send(split[0][0])
    for step in range(STEPS):
        halves[1].send(split[step][1])
        parts = [halves[0].recv()]
        if step + 1 < STEPS:
            first = {key: array.copy() for key, array in parts[0][0].items()}
            parts = [(first, *parts[0][1:])]
            halves[0].send(split[step + 1][0])
        parts.append(halves[1].recv())
        expected = whole.step(actions[step])
        for key, array in expected[0].items():
            np.testing.assert_array_equal(np.concatenate([part[0][key] for part in parts]), array)
        for k in (1, 2, 3):
            np.testing.assert_array_equal(np.concatenate([part[k] for part in parts]), expected[k])


def test_what_a_sent_step_raises_comes_with_recv() -> None:
    env = make()
    before = digest(env.worlds)
    env.send(np.zeros((1, 2, 3), int))
    with pytest.raises(ActionError, match="shape"):
        env.recv()
    assert digest(env.worlds) == before
    env.send(draw_actions(env, np.random.default_rng(0)))
    env.recv()
    env.send(draw_actions(env, np.random.default_rng(0)))
    env.close()  # waits for the step
    with pytest.raises(ClosedError):
        env.step(draw_actions(env, np.random.default_rng(0)))


def test_actions_that_were_sent_are_the_environments_own() -> None:
    one, other, rng = make(), make(), np.random.default_rng(0)
    for _ in range(STEPS):
        actions = draw_actions(one, rng)
        expected = other.step(actions.copy())
        one.send(actions)
        actions[:] = 0
        same(one.recv()[0], expected[0])
    assert digest(one.worlds) == digest(other.worlds)


@pytest.mark.parametrize(
    ("out", "reason"),
    [
        (lambda env: np.zeros((WORLDS, 2, env.flat_size)), "out is float64"),
        (lambda env: np.zeros((WORLDS, 2, env.flat_size + 1), np.float32), "out is float32"),
        (lambda env: {"own": np.zeros((WORLDS, 2, 8), np.float32)}, r"out has the keys \['own'\]"),
        (lambda env: {**{k: a.copy() for k, a in env.observe().items()}, "zone": [1]}, r"out\['zone'\] is list"),
        (lambda env: dict(env.observe()), "is read-only"),
        (lambda env: 3, "out is int"),
        (lambda env: {1: 2, "own": 3}, r"out has the keys \['own', 1\]"),
        (lambda env: as_strided(np.zeros(env.flat_size, np.float32), (WORLDS, 2, env.flat_size), (0, 0, 4)), "share"),
    ],
)
def test_memory_that_does_not_fit_is_refused(out: Any, reason: str) -> None:
    env = make()
    with pytest.raises(ValueError, match=reason):
        env.observe(out(env))


def test_one_array_for_two_things_is_refused() -> None:
    env, ends = make(), np.zeros(WORLDS, bool)
    with pytest.raises(ValueError, match="one array for two names"):
        env.step(np.tile(env.noop, (WORLDS, env.num_agents, 1)), out={"terminated": ends, "truncated": ends})
    with pytest.raises(ValueError, match="out has the name 'a': a mapping is needed"):
        env.step(np.tile(env.noop, (WORLDS, env.num_agents, 1)), out={1: ends, "a": ends})
