"""Gymnasium's vector wrappers around worlds: each one works, or is for other spaces."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import vector as wrappers

from outlast import make_vec
from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.helpers.execution_modes import equal

WORLDS, STEPS = 3, 5
Wrap = Callable[[SurvivalVectorEnv], Any]
KEYS = ("own", "zone")


def others(observation: dict[str, Any]) -> dict[str, Any]:
    return {key: observation[key] for key in KEYS}


WORKING: dict[str, Wrap] = {
    "ClipReward": lambda env: wrappers.ClipReward(env, 0.0, 0.5),
    "DictInfoToList": wrappers.DictInfoToList,
    "DtypeObservation": lambda env: wrappers.DtypeObservation(wrappers.FlattenObservation(env), np.float64),
    "FilterObservation": lambda env: wrappers.FilterObservation(env, KEYS),
    "FlattenObservation": wrappers.FlattenObservation,
    "TransformAction": lambda env: wrappers.TransformAction(env, lambda actions: actions, env.action_space),
    "TransformObservation": lambda env: wrappers.TransformObservation(env, others),
    "TransformReward": lambda env: wrappers.TransformReward(env, lambda reward: 2 * reward),
    "VectorizeTransformReward": lambda env: wrappers.VectorizeTransformReward(
        env, gymnasium.wrappers.TransformReward, func=lambda reward: 2 * reward
    ),
    "VectorizeTransformObservation": lambda env: wrappers.VectorizeTransformObservation(
        env, gymnasium.wrappers.FilterObservation, filter_keys=KEYS
    ),
    "VectorizeTransformAction": lambda env: wrappers.VectorizeTransformAction(
        env, gymnasium.wrappers.TransformAction, func=lambda action: action, action_space=env.single_action_space
    ),
    "NormalizeObservation": lambda env: wrappers.NormalizeObservation(wrappers.FlattenObservation(env)),
}
# Gymnasium itself refuses these, as it has them for spaces that are Boxes, or bounded
REFUSED = {
    "ClipAction", "GrayscaleObservation", "RescaleAction", "RescaleObservation", "ReshapeObservation",
    "ResizeObservation",
}  # fmt: skip
ELSEWHERE = {"HumanRendering", "RecordVideo"}  # they take what render() returns: see tests/rendering
SUMMING = {"NormalizeReward", "RecordEpisodeStatistics"}  # of one reward for each world; here every agent has its own


def test_every_wrapper_is_tried() -> None:
    """But those that are loaded late, as they convert to libraries that need not be there."""
    assert {*WORKING, *REFUSED} | ELSEWHERE | SUMMING | set(wrappers._wrapper_to_class) == set(wrappers.__all__)


@pytest.mark.parametrize("name", WORKING)
def test_a_wrapper_leaves_the_game_as_it_is(name: str) -> None:
    env, plain = (make_vec("ffa_1", WORLDS, seed=0) for _ in range(2))
    wrapped = WORKING[name](env)
    wrapped.reset(seed=1)
    plain.reset(seed=1)
    plain.action_space.seed(1)
    for _ in range(STEPS):
        actions = plain.action_space.sample()
        _, reward, terminated, truncated, _ = wrapped.step(actions)
        _, expected, *flags, _ = plain.step(actions)
        assert reward.shape == expected.shape == (WORLDS, 2)
        assert np.array_equal(flags, [terminated, truncated])
    assert equal(env.observe(), plain.observe())
