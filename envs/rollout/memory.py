"""Policies with a memory, which need to know where episodes begin."""

from collections.abc import Sequence
from typing import Any

from outlast.ecs import Clock

from ..core.validation import Array
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from .policies import Policy


class Begins:
    """The worlds in which an episode begins, or goes on from a state that was set."""

    def __init__(self, env: SurvivalVectorEnv) -> None:
        self._tick, self._set = env.worlds[Clock].tick[:, 0], env._tracker.set_states
        self._seen = self._set - 1

    def look(self) -> Array:
        """Return these, bool (worlds,), in the first call all. To be called once before each step of the worlds."""
        begins: Array = (self._tick == 0) | (self._set != self._seen)
        self._seen[:] = self._set
        return begins


def has_memory(policy: Policy) -> bool:
    """Return whether the policy has a method `reset`."""
    return callable(getattr(policy, "reset", None))


def check_memories(policies: Sequence[Any]) -> None:
    """Raise UsageError if a policy with a memory is listed twice, as its memory would be updated twice in each tick."""
    for k, policy in enumerate(policies):
        if has_memory(policy) and any(policy is other for other in policies[:k]):
            raise UsageError(
                f"{getattr(policy, '__name__', policy)} plays twice, and has a memory (a method reset), which would be "
                "moved on twice a tick: give each side an object of its own"
            )


def tell(policy: Any, where: Array) -> None:
    """Notify a policy, if it has a memory, of the worlds in which episodes begin, bool (worlds,)."""
    if has_memory(policy) and where.any():
        policy.reset(where)


def told(policy: Policy, env: SurvivalVectorEnv) -> Policy:
    """Return the policy with a memory that is reset where episodes begin; the policy itself, if it has no memory.

    policy: A function from observations to actions. A method `reset` makes it a policy with a memory: if since its last
    call episodes have begun in some worlds, or have gone on from a state that was set, `reset` is called first, with
    these worlds, bool (worlds,). Before the very first call it gets all worlds. env: The worlds. Call the result once
    before each of their steps.
    """
    if not callable(policy):
        raise UsageError(f"policy = {policy!r}: a function is needed, such as outlast.policies.scripted_policy(env)")
    if not has_memory(policy):
        return policy
    begins = Begins(env)

    def act(observations: Arrays) -> Actions:
        tell(policy, begins.look())
        return policy(observations)

    return act
