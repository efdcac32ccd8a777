"""Policies with a memory: they are told where episodes begin."""

from typing import Any

import numpy as np

from outlast.ecs import Clock

from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from .policies import Policy

Array = np.ndarray[Any, Any]


class Begins:
    """In which worlds an episode begins, or goes on from a state that was set.

    Args:
        env: The worlds. Look at them once before each of their steps.
    """

    def __init__(self, env: SurvivalVectorEnv) -> None:
        self._clock, self._set = env.worlds[Clock], env._tracker.set_states
        self._seen: list[Array] = []

    def look(self) -> Array:
        """Where that happened since the last look, bool (worlds,); at the first one, everywhere."""
        clock = self._clock
        keys = [column.copy() for column in (clock.seed[:, 0], clock.world[:, 0], clock.episode[:, 0], self._set)]
        begins: Array = clock.tick[:, 0] == 0  # also where the same episode begins again
        for key, seen in zip(keys, self._seen or [~key for key in keys], strict=True):
            begins |= key != seen
        self._seen = keys
        return begins


def tell(policy: Policy, where: Array) -> None:
    """Tell a policy that has a memory, and so a method `reset`, in which worlds episodes begin, bool (worlds,)."""
    if where.any() and callable(reset := getattr(policy, "reset", None)):
        reset(where)


def told(policy: Policy, env: SurvivalVectorEnv) -> Policy:
    """The policy, told where episodes begin before it acts there; itself, if it has no memory.

    Args:
        policy: A function from observations to actions. If it has a method `reset`, that is called before the policy
            where in some worlds an episode begins, or goes on from a state that was set, since the policy was called
            last. It gets these worlds, bool (worlds,); before the first call of all, all worlds.
        env: The worlds. The result is to be called once before each of their steps.
    """
    if not callable(getattr(policy, "reset", None)):
        return policy
    begins = Begins(env)

    def act(observations: Arrays) -> Actions:
        tell(policy, begins.look())
        return policy(observations)

    return act
