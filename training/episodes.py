"""The paper's quantities: means over the episodes that ended, by the names that its TensorBoard files have."""

from typing import Any

import numpy as np

from outlast.components import Side
from outlast.envs.core.vector_env import SurvivalVectorEnv

Array = np.ndarray[Any, Any]
NAMES = {"length": "steps", "return": "reward"}  # where ours differ


class Episodes:
    """Sums of statistics of episodes, until they are reported."""

    def __init__(self, core: SurvivalVectorEnv) -> None:
        self.worlds = core.worlds
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self.count = 0
        self.sums: dict[str, Array] = {}

    def add(self, statistics: dict[str, Array], count: int) -> None:
        """Add `count` episodes: what info["statistics"] holds, in which the rows of other worlds are zero."""
        self.count += count
        for key, values in statistics.items():
            self.sums[key] = self.sums.get(key, 0) + values.sum(0, dtype=np.float64)

    def report(self) -> dict[str, float]:
        """Means since the last report, by tag. A team's return is that of its first agent, as all have the same."""
        tags = {"rollout/episodes": float(self.count)}
        for key, total in self.sums.items():
            mean, name = total / self.count, "rollout/" + NAMES.get(key, key)
            if mean.ndim == 0:
                tags[name] = float(mean)
            else:
                each = mean[self._first()] if key == "return" else mean
                tags |= {f"{name}{k}": float(value) for k, value in enumerate(each)}
        self.clear()
        return tags

    def _first(self) -> Array:
        """The agents whose returns are reported: all, or the first of each team."""
        sides = self.worlds[Side].side[0, self.worlds.span("agent")]
        first: Array = np.unique(sides, return_index=True)[1]  # without teams, every agent is a side
        return first
