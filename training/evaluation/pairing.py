"""A pairing that was played, and estimates of what happened in it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .matches import MatchResults

Array = np.ndarray[Any, Any]
Estimates = dict[str, tuple[float, float]]  # mean and standard error by name


@dataclass(frozen=True)
class Pairing:
    """A pairing that was played: the indices of its policies, which may be the same policy, and all its episodes."""

    pair: tuple[int, int]
    results: MatchResults

    def estimates(self, role: int) -> Estimates:
        """Estimates for the policy in that role. NaN where there was nothing to measure."""
        return {name: ratio(figure[:, :, role].reshape(-1, 2)) for name, figure in self.results.figures.items()}

    def won_drawn_lost(self) -> tuple[int, int, int]:
        """Return how many episodes the first policy won, drew and lost."""
        wins = self.results.figures["wins"][:, :, 0, 0]
        return int((wins == 1).sum()), int((wins == 0.5).sum()), int((wins == 0).sum())


def ratio(pairs: Array) -> tuple[float, float]:
    """The sum of all sums over the sum of all counts, and its standard error to first order.

    pairs: float64 (episodes, 2), sums and counts; if all counts are 1, this is a mean and its error. Both are NaN if
    all counts are 0; the error also if all but one are.
    """
    total, count = pairs.sum(0)
    there = np.count_nonzero(pairs[:, 1])
    if not count:
        return float("nan"), float("nan")
    mean = total / count
    rest = pairs[:, 0] - mean * pairs[:, 1]
    if there < 2:
        return float(mean), float("nan")
    spread = (rest * rest).sum() * there / (there - 1)
    return float(mean), float(np.sqrt(spread) / count)
