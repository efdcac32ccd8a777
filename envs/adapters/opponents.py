"""Who plays the agents that do not learn: a policy by name, or a function."""

import os
from typing import Any

import numpy as np

from outlast.ecs import Clock

from ..core.validation import Array, as_array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import ActionError
from ..rollout.policies import GOLDEN, Policy, joint_action_sampler, mix64, noop_policy, scripted_policy

Others = str | Policy
NAMES = ("noop", "random", "scripted")


class Opponents:
    """All agents of all worlds but the learner.

    others: "noop", "random", "scripted" (envs.policies says what they do), or a function (observations) -> actions. As
    all policies, it is called for the whole batch (a single environment is a batch of one world), but it is told only
    of the agents that it plays, in order of id with the learner left out: observations are a dict of read-only float32
    (worlds, agents - 1, ...), overwritten later; actions are integers (worlds, agents - 1, actions). It is not told
    when episodes begin: a policy with a memory cannot play.

    "random" is a function of (seed, world, episode, tick, agent): a world plays the same alone and in any batch.
    """

    def __init__(self, others: Others, core: SurvivalVectorEnv, learner: int) -> None:
        self.core = core
        ids = [i for i in range(core.num_agents) if i != learner]
        self.seats: Any = ids  # a slice where that is possible, which copies nothing
        if learner in (0, core.num_agents - 1):
            self.seats = slice(1, None) if learner == 0 else slice(0, learner)
        self.shape = (core.num_worlds, len(ids), len(core.action_sizes))
        self._policy = self._named(others, np.array(ids, np.uint64)) if isinstance(others, str) else others

    def actions(self) -> Array:
        """What they do in the worlds as they are now, (worlds, agents - 1, actions). Raises ActionError."""
        if not self.shape[1]:
            return np.zeros(self.shape, np.int8)
        seen = {key: values[:, self.seats] for key, values in self.core.observe().items()}
        actions = as_array(self._policy(seen))
        if actions.shape != self.shape or actions.dtype.kind not in "iu":
            raise ActionError(
                f"others: the policy returned {actions.dtype} of shape {actions.shape}: "
                f"integers, (worlds, agents but the learner, actions) = {self.shape}, are needed"
            )
        return actions

    def _named(self, name: str, ids: Array) -> Policy:
        if name == "scripted":
            return scripted_policy(self.core)
        if name == "noop":
            idle = noop_policy(self.core)
            return lambda observations: idle(observations)[:, 1:]
        return self._random(ids)

    def _random(self, ids: Array) -> Policy:
        """Every action uniform and independent: one draw among all joint actions (216 in the paper)."""
        draw, clock = joint_action_sampler(self.core.action_sizes), self.core.worlds[Clock]
        return lambda observations: draw(_scrambled(clock.seed, clock.world, clock.episode, clock.tick, ids[None]))


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


def _scrambled(*parts: Array) -> Array:
    """A uniform uint64 for each combination of the parts."""
    word = np.zeros((1, 1), np.uint64)
    for part in parts:
        word = mix64((word ^ part) + GOLDEN)
    return word
