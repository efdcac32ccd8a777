"""One world, agent by agent: the spaces and the actions of single agents."""

from typing import Any

import numpy as np
from gymnasium import spaces

from ..core.validation import Array, as_array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import ActionError


def agent_spaces(batch: SurvivalVectorEnv) -> tuple[list[spaces.Dict], list[spaces.MultiDiscrete]]:
    """What each agent alone sees and does: row i of the spaces of a world, in objects of their own."""
    seen: Any = batch.single_observation_space
    boxes = [{key: (box.low[i], box.high[i]) for key, box in seen.items()} for i in range(batch.num_agents)]
    observations = [
        spaces.Dict({key: spaces.Box(low, high, dtype=np.float32) for key, (low, high) in row.items()}) for row in boxes
    ]
    return observations, [spaces.MultiDiscrete(batch.action_sizes) for _ in range(batch.num_agents)]


def agent_action(agent: str, given: Any, sizes: Array) -> Array:
    """The action of one agent as an integer array, each below its size; ActionError."""
    action = as_array(given)
    if action.shape != sizes.shape or action.dtype.kind not in "iu":
        raise ActionError(f"the action of {agent} is {given!r}: {len(sizes)} integers are needed")
    bad = np.flatnonzero((action < 0) | (action >= sizes))
    if bad.size:
        k = int(bad[0])
        raise ActionError(f"action {k} of {agent} is {action[k]}: 0 to {sizes[k] - 1} is allowed")
    return action
