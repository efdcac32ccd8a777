"""Policies with a memory: they are told where episodes begin."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from outlast.ecs import Clock

from ..core.described import Actions, Arrays
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError
from .policies import Policy

Array = np.ndarray[Any, Any]


class Begins:
    """In which worlds an episode begins, or goes on from a state that was set.

    Args:
        env: The worlds. Look at them once before each of their steps.
    """

    def __init__(self, env: SurvivalVectorEnv) -> None:
        self._tick, self._set = env.worlds[Clock].tick[:, 0], env._tracker.set_states
        self._seen = self._set - 1

    def look(self) -> Array:
        """Where that happened since the last look, bool (worlds,); at the first one, everywhere."""
        begins: Array = (self._tick == 0) | (self._set != self._seen)
        self._seen[:] = self._set
        return begins


def has_memory(policy: Policy) -> bool:
    """Whether it has a method `reset`."""
    return callable(getattr(policy, "reset", None))


def check_memories(policies: Sequence[Any]) -> None:
    """UsageError if one of the policies has a memory and is there twice, which would be moved on twice a tick."""
    for k, policy in enumerate(policies):
        if has_memory(policy) and any(policy is other for other in policies[:k]):
            raise UsageError(
                f"{getattr(policy, '__name__', policy)} plays twice, and has a memory (a method reset), which would be "
                "moved on twice a tick: give each side an object of its own"
            )


def tell(policy: Any, where: Array) -> None:
    """Tell a policy, if it has a memory, in which worlds episodes begin, bool (worlds,)."""
    if has_memory(policy) and where.any():
        policy.reset(where)


def told(policy: Policy, env: SurvivalVectorEnv) -> Policy:
    """The policy, told where episodes begin before it acts there; itself, if it has no memory.

    Args:
        policy: A function from observations to actions. If it has a method `reset`, that is called before the policy
            where in some worlds an episode begins, or goes on from a state that was set, since the policy was called
            last. It gets these worlds, bool (worlds,); before the first call of all, all worlds.
        env: The worlds. The result is to be called once before each of their steps.
    """
    if not has_memory(policy):
        return policy
    begins = Begins(env)

    def act(observations: Arrays) -> Actions:
        tell(policy, begins.look())
        return policy(observations)

    return act
