"""Who plays the agents that do not learn: a policy by name, or a function."""

import os
from typing import Any

import numpy as np

from outlast.ecs import Clock

from ..core.validation import Array, checked_actions
from ..core.vector_env import SurvivalVectorEnv
from ..rollout.policies import GOLDEN, Policy, joint_action_sampler, mix64, noop_policy, scripted_policy

Others = str | Policy
NAMES = ("noop", "random", "scripted")


class Opponents:
    """All agents of all worlds but the learner.

    A policy is called for all worlds at once (a single environment is a batch of one world). It gets the observations
    of the agents that it plays only, in order of id with the learner left out: a dict of read-only float32
    (worlds, agents - 1, ...), which the next tick overwrites. It returns integers (worlds, agents - 1, actions). It is
    not informed when episodes begin: a policy with a memory cannot play.

    "random" is a function of (seed, world, episode, tick, agent): a world is played the same alone and in any batch.

    Attributes:
        agent_indices: Which agents of a world it plays, a list or a slice.

    Args:
        others: "noop", "random", "scripted" (envs.rollout.policies describes them), or a function (observations) ->
            actions.
        base_env: The worlds.
        learner: Index of the agent that is left out.
    """

    def __init__(self, others: Others, base_env: SurvivalVectorEnv, learner: int) -> None:
        self.base_env = base_env
        ids = [i for i in range(base_env.num_agents) if i != learner]
        self.agent_indices: Any = ids  # a slice where that is possible, which copies nothing
        if learner in (0, base_env.num_agents - 1):
            self.agent_indices = slice(1, None) if learner == 0 else slice(0, learner)
        self.shape = (base_env.num_worlds, len(ids), len(base_env.action_sizes))
        self._policy = self._named(others, np.array(ids, np.uint64)) if isinstance(others, str) else others

    def actions(self) -> Array:
        """Their actions in the worlds as they are now, (worlds, agents - 1, actions). Raises ActionError."""
        if not self.shape[1]:
            return np.zeros(self.shape, np.int8)
        observations = {key: values[:, self.agent_indices] for key, values in self.base_env.observe().items()}
        actions = self._policy(observations)
        what, axes = "others: the actions that the policy returned", "(worlds, agents but the learner, actions)"
        return checked_actions(actions, self.shape, self.base_env.action_sizes, False, what=what, axes=axes)

    def _named(self, name: str, ids: Array) -> Policy:
        if name == "scripted":
            return scripted_policy(self.base_env)
        if name == "noop":
            idle = noop_policy(self.base_env)
            return lambda observations: idle(observations)[:, 1:]
        return self._random(ids)

    def _random(self, ids: Array) -> Policy:
        """Every action uniform and independent: one draw among all joint actions (216 in the paper)."""
        draw, clock = joint_action_sampler(self.base_env.action_sizes), self.base_env.worlds[Clock]
        return lambda observations: draw(_hashed(clock.seed, clock.world, clock.episode, clock.tick, ids[None]))


def check_others(others: Any) -> None:
    """ValueError unless it can play: one of NAMES, or a function."""
    if others in NAMES if isinstance(others, str) else callable(others):
        return
    names = ", ".join(map(repr, NAMES))
    hint = "; others=outlast.load_policy(path) plays what `outlast train` saved"
    raise ValueError(
        f"others = {others!r}: {names} or a function (observations) -> actions is needed"
        f"{hint if isinstance(others, str | os.PathLike) else ''}"
    )


def _hashed(*parts: Array) -> Array:
    """A uniform uint64 for each combination of the parts."""
    word = np.zeros((1, 1), np.uint64)
    for part in parts:
        word = mix64((word ^ part) + GOLDEN)
    return word
