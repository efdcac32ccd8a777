"""Records of policies: the probabilities of actions, the estimate of the value, and the attention.

There is a row, of the dtype `policy_dtype`, for each agent and tick. It is about its observation before the tick:

============= ======= =============================================================================================
value         float32 the critic's estimate, in the units that it was trained in; NaN: it has none
probabilities float16 of each value of each action, one action after the other; NaN: not an agent of this policy
attention     float16 share of each row of `entities`, kind after kind; together at most 1; NaN: it has none
============= ======= =============================================================================================
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import RecordingError
from ..rollout.memory import Begins, tell
from ..scenarios.fingerprint import is_word

MAX_ENTRIES = 2**16  # maximum probabilities, and rows, of an agent


class Explainer(Protocol):
    """The explanation of a policy's choices, made by its method `explainer()`. With a memory it also has `reset`."""

    entities: list[tuple[str, int]]  # (key of the observation, number of rows) of each kind that it attends to

    def __call__(self, observations: Any) -> tuple[Array, Array, Array]:
        """Return values (worlds, agents), probabilities (worlds, agents, values), attention (worlds, agents, rows)."""


class PolicyRecorder:
    """A record of a policy's choices before each tick of an environment. For arguments and errors see `record`."""

    def __init__(self, env: SurvivalVectorEnv, policy: Any, plays: Callable[[], Array] | None = None) -> None:
        if not hasattr(policy, "explainer"):
            raise RecordingError(
                "the policy does not report the probabilities of its choices, so it cannot be recorded: only "
                "saved policies do, a FILE.zip, a FILE.safetensors or what outlast.load_policy returns"
            )
        policy.check(env)
        self._env, self._plays, self._begins = env, plays, Begins(env)
        self._explain: Explainer = policy.explainer()
        self.header = {"entities": [list(entry) for entry in self._explain.entities]}
        self.dtype = policy_dtype([["", 0, int(size)] for size in env.action_sizes], self.header)

    def look(self, steps: Array) -> Array:
        """Return the record of its present choices: dtype (worlds, agents), of the worlds `steps`, bool (worlds,)."""
        found = np.zeros((self._env.num_worlds, self._env.num_agents), self.dtype)
        if steps.any():
            tell(self._explain, self._begins.look())
            found["value"], found["probabilities"], found["attention"] = self._explain(self._env._reader.views)
            if self._plays is not None:
                found[~np.asarray(self._plays())] = np.full((), np.nan, self.dtype)
        return found[steps]


def policy_dtype(actions: Any, policy: Any) -> np.dtype[Any]:
    """Return the type of a row. actions, policy: as in the header of a recording."""
    values, rows = sum(size for _, _, size in actions), sum(count for _, count in policy["entities"])
    return np.dtype([("value", "<f4"), ("probabilities", "<f2", (values,)), ("attention", "<f2", (rows,))])


def is_policy(actions: Any, policy: Any) -> bool:
    """Return whether a header's entry for the policy is valid, given its valid actions."""
    counts = [count for key, count in policy["entities"] if is_word(key) and type(count) is int and count >= 0]
    values = sum(size for _, _, size in actions)
    return len(counts) == len(policy["entities"]) and max(values, sum(counts)) <= MAX_ENTRIES
