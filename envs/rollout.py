"""Rollouts: run a policy in many worlds for many steps and sum up the episodes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .policies import Policy
from .vector import SurvivalVectorEnv


@dataclass
class Summary:
    """Mean and standard error of every episode statistic, from sums; nothing is kept of single episodes.

    Episodes that were still running at the end are not in it, and long ones are more likely to be among them: with
    steps enough for only a few episodes a world, the means lean towards short episodes.
    """

    episodes: int = 0
    sums: dict[str, np.ndarray[Any, Any]] = field(default_factory=dict)
    squares: dict[str, np.ndarray[Any, Any]] = field(default_factory=dict)

    def add(self, statistics: dict[str, Any], where: np.ndarray[Any, Any]) -> None:
        """Count the episodes `where` of info["statistics"]."""
        self.episodes += int(where.sum())
        for key, values in statistics.items():
            chosen = np.asarray(values, np.float64)[where]
            self.sums[key] = self.sums.get(key, 0.0) + chosen.sum(0)
            self.squares[key] = self.squares.get(key, 0.0) + (chosen**2).sum(0)

    def rows(self) -> list[tuple[str, float, float]]:
        """(name, mean, standard error); statistics with an entry an agent or side get a row for each."""
        rows = []
        for key in sorted(self.sums):
            mean = np.atleast_1d(self.sums[key] / self.episodes)
            spread = np.maximum(np.atleast_1d(self.squares[key] / self.episodes) - mean**2, 0)
            error = np.sqrt(spread / max(self.episodes - 1, 1))
            names = [key] if np.ndim(self.sums[key]) == 0 else [f"{key} {k}" for k in range(len(mean))]
            rows += list(zip(names, mean.tolist(), error.tolist(), strict=True))
        return rows

    def __str__(self) -> str:
        if not self.episodes:
            return "no episode ended; take more steps"
        lines = [f"{'per episode':<20} {'mean':>12} {'std. error':>12}"]
        lines += [f"{name:<20} {mean:>12.4f} {error:>12.4f}" for name, mean, error in self.rows()]
        return "\n".join(lines)


def rollout(
    env: SurvivalVectorEnv, policy: Policy, steps: int, progress: Callable[[int], None] = lambda steps: None
) -> Summary:
    """Reset everything, take `steps` steps of every world, and sum up all episodes that end.

    progress is called after every step with the number of steps done. Ctrl-C ends it early; the summary so far is
    returned by raising KeyboardInterrupt with it as its argument.
    """
    summary = Summary()
    observations, _ = env.reset()
    try:
        for step in range(steps):
            observations, _, _, _, info = env.step(policy(observations))
            if "statistics" in info:
                summary.add(info["statistics"], info["_statistics"])
            progress(step + 1)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(summary) from None
    return summary
