"""What is said of curves: their moving average over seeds, its peak, and where they end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .curves import Array, Curves

END = 0.1  # of the points: what is called the end of a run
SMOOTH = 20  # a moving average is over one part in so many of the points
CLOSE = 0.15  # apart from the paper's end: what counts as the same, for returns and lengths


@dataclass(frozen=True)
class Ending:
    """Mean and standard deviation of the points of the last tenth of a curve."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class Average:
    """The moving averages of runs: their mean, lowest and highest at each number of agent-steps, all (points,).

    Where some runs have ended it is that of the others.
    """

    steps: Array
    mean: Array
    low: Array
    high: Array

    @property
    def peak(self) -> tuple[int, float]:
        """Agent-steps and height of the highest point."""
        top = int(np.nanargmax(self.mean))
        return int(self.steps[top]), float(self.mean[top])


def average(runs: Sequence[Curves], tag: str) -> Average:
    """Over the runs that have the tag: at least one."""
    curves = [one for one in runs if tag in one.values]
    steps = np.unique(np.concatenate([one.steps for one in curves]))
    every = np.full((len(curves), len(steps)), np.nan)
    for row, one in zip(every, curves, strict=True):
        row[np.searchsorted(steps, one.steps)] = smooth(one.values[tag])
    there = np.isfinite(every).any(0)
    every = every[:, there]
    return Average(steps[there], np.nanmean(every, 0), np.nanmin(every, 0), np.nanmax(every, 0))


def smooth(values: Array) -> Array:
    """The moving average over the points around each. At both ends there are fewer of them; NaNs are left out."""
    half = window(len(values)) // 2
    there = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(there, values, 0.0), dtype=np.float64)])
    counts = np.concatenate([[0], np.cumsum(there)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    with np.errstate(invalid="ignore"):
        averages: Array = (sums[last] - sums[first]) / (counts[last] - counts[first])
    return averages


def window(points: int) -> int:
    """How many points a moving average is over: an odd number."""
    return max(1, points // SMOOTH) | 1


def ending(values: Array) -> Ending:
    """Of a curve that has at least one number."""
    there = values[np.isfinite(values)].astype(np.float64)
    last = there[-max(1, round(END * len(there))) :]
    return Ending(float(last.mean()), float(last.std(ddof=1)) if len(last) > 1 else 0.0)
