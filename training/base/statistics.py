"""Statistics over training runs, after Agarwal et al., "Deep RL at the Edge of the Statistical Precipice", 2021.

arXiv:2108.13264; the formulas are those of its library rliable 1.2.0, with whose values they agree. Scores are given by
task, one for each run (training seed). Scores that are pooled over tasks must have the same scale, as win rates do.

>>> scores = {"ffa_2": [0.6, 0.7, 0.5], "teams_2": [0.4, 0.5, 0.6, 0.4]}
>>> value, low, high = stratified_bootstrap(iqm, scores)
>>> value, low, high = stratified_bootstrap(probability_of_improvement, scores, others)
>>> profile = stratified_bootstrap(lambda each: performance_profile(each, [0.25, 0.5, 0.75]), scores)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .errors import TrainingError

Array = np.ndarray[Any, Any]
Scores = Mapping[Any, Sequence[float] | Array]  # by task's name: (runs,) each; resampled (resamplings, runs)

LEVEL = 0.95  # level of intervals
REPS = 10_000  # resamplings: ends of intervals are then known to one or two hundredths of their width


class Estimate(NamedTuple):
    """A statistic and its 95 % interval.

    Attributes:
        value: The statistic of the scores themselves: a float, or float64 (thresholds,) for a performance profile.
        low: Lower end of the interval, of the same shape.
        high: Upper end of the interval, of the same shape.
    """

    value: Any
    low: Any
    high: Any


def mean(scores: Scores) -> Any:
    """Return the mean over tasks of the means over runs. Arguments as for `iqm`."""
    return np.mean(_task_means(scores), 0)


def median(scores: Scores) -> Any:
    """Return the median over tasks of the means over runs. Arguments as for `iqm`."""
    return np.median(_task_means(scores), 0)


def iqm(scores: Scores) -> Any:
    """Return the interquartile mean: the mean of the middle half of the scores of all runs of all tasks.

    At each end, scores are left out as long as they weigh a quarter or less together: with 7 scores, one at each end,
    as in scipy.stats.trim_mean. Every task weighs the same: where tasks have different numbers of runs, the runs of a
    task that has fewer weigh more.

    Args:
        scores: By task, (..., runs) each. Leading axes, which all tasks have in common, are kept.

    Returns:
        float64 (...): a number if scores have no leading axes.

    Raises:
        TrainingError: Scores are empty, or not only numbers.
    """
    tasks = _checked(scores)
    runs = [each.shape[-1] for each in tasks]
    common = math.lcm(*runs)  # integer weights keep sums exact
    weights = np.repeat([common // count for count in runs], runs)
    pooled = np.concatenate(tasks, -1)
    order = np.argsort(pooled, -1, kind="stable")
    ordered, weight = np.take_along_axis(pooled, order, -1), weights[order]
    below = weight.cumsum(-1)
    above = weights.sum() - below + weight
    kept = weight * ((4 * below > weights.sum()) & (4 * above > weights.sum()))
    return (ordered * kept).sum(-1) / kept.sum(-1)


def probability_of_improvement(ours: Scores, theirs: Scores) -> Any:
    """Return how probable it is that a run of ours scores more than one of theirs in a task: the mean over tasks.

    Equal scores count half: it is the Mann-Whitney statistic, divided by the number of pairs.

    Args:
        ours: By task, (..., runs) each.
        theirs: Scores in the same tasks, with any number of runs.

    Returns:
        float64 (...): from 0 to 1; 0.5: neither is better.
    """
    if unmatched := set(ours) ^ set(theirs):
        raise TrainingError(f"only one side has scores of {', '.join(sorted(map(str, unmatched)))}: leave these out")
    pairs = zip(_checked(ours), _checked({task: theirs[task] for task in ours}), strict=True)
    each = ((mine[..., :, None], other[..., None, :]) for mine, other in pairs)
    return np.mean([((a > b).mean((-2, -1)) + (a >= b).mean((-2, -1))) / 2 for a, b in each], 0)


def performance_profile(scores: Scores, thresholds: Sequence[float] | Array) -> Array:
    """Return the share of runs that score more than each threshold; every task has the same weight.

    Arguments as for `iqm`, and thresholds, (thresholds,). Returns float64 (..., thresholds).
    """
    bounds = _numbers("thresholds", thresholds)
    if bounds.ndim != 1:
        raise TrainingError(f"thresholds of shape {bounds.shape}: expected a list of numbers")
    return np.mean([(each[..., None] > bounds).mean(-2) for each in _checked(scores)], 0)


def stratified_bootstrap(
    statistic: Callable[..., Any], *scores: Scores, reps: int = REPS, seed: int = 0, level: float = LEVEL
) -> Estimate:
    """Return a statistic with its 95 % interval: percentiles of its values for resampled runs.

    Within each task (a stratum), as many runs are drawn, with replacement, as the task has; several sets of scores are
    resampled independently of each other. So the interval covers other training seeds in the same tasks, but not other
    tasks. It is too narrow where runs are few: with two or three runs of one task, it goes from the
    lowest score to the highest, which misses the median of all possible runs in 1/2 or 1/4 of cases.

    Args:
        statistic: A function of as many sets of scores as are given, which keeps leading axes: `iqm`, `mean`, `median`,
            `probability_of_improvement`, or one of your own.
        *scores: By task, (runs,) each; at least two runs of each task.
        reps: How often runs are resampled.
        seed: The same seed and the same order of tasks give the same interval.
        level: Level of the interval, such as 1 - 0.05 / n for each of n comparisons.

    Returns:
        The statistic of the scores, and the ends of its interval.

    Raises:
        TrainingError: Scores are empty, or not only numbers, or a task has a single run.
    """
    if reps < 1:
        raise TrainingError(f"reps = {reps}: expected at least 1 resampling")
    generator = np.random.default_rng(seed)
    resampled = [_resampled(each, reps, generator) for each in scores]
    return Estimate(statistic(*scores), *percentile_interval(statistic(*resampled), level))


def interval(values: Sequence[float] | Array, *, reps: int = REPS, seed: int = 0) -> tuple[float, float] | None:
    """Return the 95 % bootstrap interval of the mean over the runs of one task; None for a single run.

    Raises TrainingError, see `stratified_bootstrap`.
    """
    if len(values) == 1:
        return None
    _, low, high = stratified_bootstrap(mean, {"the task": values}, reps=reps, seed=seed)
    return float(low), float(high)


def percentile_interval(resampled: Array, level: float = LEVEL) -> tuple[Any, Any]:
    """Return the ends of the interval of that level, from a statistic's values for resampled data, (reps, ...)."""
    low, high = np.quantile(resampled, ((1 - level) / 2, (1 + level) / 2), axis=0)
    return low, high


def _task_means(scores: Scores) -> list[Array]:
    return [each.mean(-1) for each in _checked(scores)]


def _resampled(scores: Scores, reps: int, generator: np.random.Generator) -> dict[str, Array]:
    drawn = {}
    for task, values in zip(scores, _checked(scores), strict=True):
        if values.ndim > 1:
            raise TrainingError(f"{task}: scores of shape {values.shape}: expected one number of each run")
        if len(values) == 1:
            raise TrainingError(f"{task} has one run: an interval over runs takes two or more; train another seed")
        drawn[task] = values[generator.integers(len(values), size=(reps, len(values)))]
    return drawn


def _checked(scores: Any) -> list[Array]:
    """Return the scores of each task, float64 (..., runs). Raises TrainingError."""
    if not isinstance(scores, Mapping):
        cure = "of an array (runs, tasks): dict(enumerate(array.T))"
        raise TrainingError(f"scores: expected those of all runs by task, not a {type(scores).__name__}; {cure}")
    if not scores:
        raise TrainingError("scores are empty: expected those of all runs by task")
    return [_numbers(f"{task}: scores", values) for task, values in scores.items()]


def _numbers(what: str, values: Any) -> Array:
    try:
        numbers = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise TrainingError(f"{what}: expected numbers: {error}") from None
    if not numbers.ndim or not numbers.size:
        raise TrainingError(f"{what}: expected one or more numbers, not {values!r}")
    if not np.isfinite(numbers).all():
        where = ", ".join(map(str, np.argwhere(~np.isfinite(numbers))[0]))
        raise TrainingError(f"{what}: number {where} (from 0 on) is {numbers[~np.isfinite(numbers)][0]}: leave it out")
    return numbers
