"""Moving averages over runs, and end values with their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .curves import Array, Curves

END = 0.1  # the share of the points that is the end of a run
SMOOTH = 20  # a moving average spans 1 / SMOOTH of the points
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)  # 97.5 % of t, 1 to 9 degrees of freedom


@dataclass(frozen=True)
class EndValue:
    """Mean and standard deviation of the last tenth of a curve's points; the deviation of a single point is NaN."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class MovingAverage:
    """Mean, lowest and highest of the moving averages of runs at each number of agent-steps, all (points,).

    Where some runs have ended, the other runs make up the average, or there are no points: see `average`.
    """

    steps: Array
    mean: Array
    low: Array
    high: Array

    @property
    def peak(self) -> tuple[int, float]:
        """The agent-steps and the height of the highest point."""
        top = int(np.nanargmax(self.mean))
        return int(self.steps[top]), float(self.mean[top])


def average(runs: Sequence[Curves], tag: str, *, common: bool = False) -> MovingAverage:
    """Average the smoothed curves of the runs that have the tag; at least one must have it.

    Between its points, a run is interpolated. common: Take only the points from where all of these runs have begun to
    where the first one ends, so that the average does not jump when a run drops out; there may be no such points.
    """
    curves = [one for one in runs if tag in one.values]
    steps = np.unique(np.concatenate([one.steps for one in curves]))
    every = np.full((len(curves), len(steps)), np.nan)  # as it is before the first point of a run, and after its last
    for row, one in zip(every, curves, strict=True):
        values = smooth(one.values[tag])
        if (own := np.isfinite(values)).any():
            row[:] = np.interp(steps, one.steps[own], values[own], left=np.nan, right=np.nan)
    there = np.isfinite(every).all(0) if common else np.isfinite(every).any(0)
    every = every[:, there]
    return MovingAverage(steps[there], np.nanmean(every, 0), np.nanmin(every, 0), np.nanmax(every, 0))


def smooth(values: Array) -> Array:
    """Return the moving average over the points around each point, which are fewer at both ends; NaNs are left out."""
    half = window_size(len(values)) // 2
    there = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(there, values, 0.0), dtype=np.float64)])
    counts = np.concatenate([[0], np.cumsum(there)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    with np.errstate(invalid="ignore"):
        averages: Array = (sums[last] - sums[first]) / (counts[last] - counts[first])
    return averages


def window_size(points: int) -> int:
    """Return how many points a moving average spans in a curve of `points` points; an odd number."""
    return max(1, points // SMOOTH) | 1


def end_value(values: Array) -> EndValue:
    """Return the end value of a curve with at least one number."""
    there = values[np.isfinite(values)].astype(np.float64)
    last = there[-max(1, round(END * len(there))) :]
    return EndValue(float(last.mean()), float(last.std(ddof=1)) if len(last) > 1 else float("nan"))


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of a mean by Student's t: lower and upper end, NaN for a single value."""
    count = len(values)
    if count < 2:
        return float("nan"), float("nan")
    free = count - 1
    factor = STUDENT[free - 1] if free <= len(STUDENT) else 1.96 + 2.372 / free + 2.823 / free**2  # Cornish and Fisher
    half = factor * float(np.std(values, ddof=1)) / count**0.5
    return float(np.mean(values)) - half, float(np.mean(values)) + half
