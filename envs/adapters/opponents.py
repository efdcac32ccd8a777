"""Who plays the agents that do not learn: a policy by name, a file, a function, or a mixture of them."""

import copy
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError
from ..rollout.memory import told
from ..rollout.mixture import Entries, Mixture, checked_entries, parse_mixture
from ..rollout.policies import Policy

Other = str | os.PathLike[str] | Policy
Others = Other | Mapping[Any, float]  # one policy, or the weight of each of several


class Opponents:
    """Who plays all agents of all worlds except the learners.

    A policy is called for all worlds at once (a single environment is a batch of one world). It only gets the
    observations of the agents that it plays, in order of id without the learner: a dict of float32
    (worlds, agents - 1, ...); functions get copies. It returns integers (worlds, agents - 1, actions). A policy with a
    memory also has a method `reset`: see memory.told. If it has a method `check`, that is first called with the worlds
    as a SurvivalVectorEnv, and raises if the policy cannot play in them.

    From a mixture, one policy is drawn for each world when an episode begins, as a function of (seed, world, episode);
    it plays all of the world's agents but the learner. Each is called for all worlds, but not while it plays in none.

    "random" is a function of (seed, world, episode, tick, agent): it plays a world in the same way in any batch.

    Attributes:
        agent_indices: Which agents of a world it plays, a list or a slice.

    Args:
        others: The name of a policy, such as "scripted" (envs.rollout.policies has all), a FILE.zip saved by `outlast
            train`, or a function (observations) -> actions. Or a mixture: weights by these, {"scripted": 2, play: 1},
            or as a text, "scripted:2,runs/a.zip:1".
        base_env: The worlds.
        learner: Index of the agent that is left out.
    """

    def __init__(self, others: Others, base_env: SurvivalVectorEnv, learner: int) -> None:
        self.base_env = base_env
        ids = [i for i in range(base_env.num_agents) if i != learner]
        self.agent_indices: Any = ids  # replaced by a slice where that is possible, as that copies nothing
        if learner in (0, base_env.num_agents - 1):
            self.agent_indices = slice(1, None) if learner == 0 else slice(0, learner)
        self.shape = (base_env.num_worlds, len(ids), len(base_env.action_sizes))
        words = "others: the actions that {0} returned", "(worlds, agents but the learner, actions)"
        entries = checked_others(others)
        # users' functions, which may keep the arrays that they get
        self._foreign = any(callable(policy) for policy, _ in entries)
        mixture = Mixture(entries, base_env, ids, (), *words)
        self._policy = mixture if mixture.forgetful else told(mixture, base_env)

    def actions(self) -> Array:
        """Return their actions in the worlds as they are now, (worlds, agents - 1, actions). Raises ActionError.

        Call it once before each step.
        """
        if not self.shape[1]:
            return np.zeros(self.shape, np.int8)
        seen = {key: values[:, self.agent_indices] for key, values in self.base_env._reader.views.items()}
        return self._policy({key: values.copy() for key, values in seen.items()} if self._foreign else seen)


def checked_others(others: Any) -> Entries:
    """Return the entries of the mixture given to Opponents: names, paths or functions, with their weights.

    Raises:
        UsageError: An entry is something else or given twice, or a weight is not above 0. It is a ValueError.
    """
    try:
        if isinstance(others, str):
            return list(parse_mixture(others).items())
        return checked_entries(others.items() if isinstance(others, Mapping) else [(others, 1)])
    except UsageError as error:
        raise UsageError(f"others = {others!r}: {error}") from None


def copied_others(others: Others, memo: Any) -> Others:
    """Return a copy, made by copy.deepcopy, so that no policy plays in two environments.

    Raises:
        UsageError: A policy cannot be copied.
    """
    try:
        return copy.deepcopy(others, memo)
    except TypeError as error:
        raise UsageError(f"others = {others!r:.80} cannot be copied: {error}; give it __deepcopy__()") from error
