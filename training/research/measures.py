"""Measurements of curves, by which the paper's claims are checked. Needs numpy only."""

import math
from collections.abc import Mapping

import numpy as np

from ..base.averages import smooth
from ..base.curves import KILLS, Array, Curves, Quantity

Runs = Mapping[str, Curves]  # a run of each variant, by its name
SUMMED = (KILLS,)  # over sides; other quantities are averaged
MILLION = 1e6


def curve(runs: Runs, variant: str, quantity: Quantity) -> Array:
    """A quantity of all sides of a run, (points,): the sum of kills, the mean of others. NaN if the run lacks it."""
    curves = runs[variant]
    own = [curves.values[tag] for tag in curves.tags(quantity)]
    if not own:
        return np.full(len(curves.steps), np.nan)
    combined: Array = np.asarray((np.sum if quantity in SUMMED else np.mean)(own, 0, dtype=np.float64))
    return combined


def part(values: Array, first: float, last: float) -> float:
    """The mean of a part of a curve, from one share of its points to another; NaNs are left out."""
    count = len(values)
    there = values[round(first * count) : max(round(first * count) + 1, round(last * count))]
    there = there[np.isfinite(there)]
    return float(there.mean()) if len(there) else float("nan")


def end(runs: Runs, variant: str, quantity: Quantity) -> float:
    """The mean of the last tenth."""
    return part(curve(runs, variant, quantity), 0.9, 1.0)


def peak(runs: Runs, variant: str, quantity: Quantity) -> float:
    """The maximum of the moving average."""
    return float(np.nanmax(smooth(curve(runs, variant, quantity)), initial=np.nan))


def peak_at(runs: Runs, variant: str, quantity: Quantity) -> float:
    """Where the maximum of the moving average is, in millions of agent-steps."""
    averages = smooth(curve(runs, variant, quantity))
    return float(runs[variant].steps[np.nanargmax(averages)]) / MILLION


def left(runs: Runs, variant: str, quantity: Quantity) -> float:
    """What is left of the peak at the end, as a share."""
    return over(end(runs, variant, quantity), peak(runs, variant, quantity))


def at(runs: Runs, variant: str, quantity: Quantity, millions: float) -> float:
    """The moving average after so many millions of agent-steps."""
    where = int(np.searchsorted(runs[variant].steps, millions * MILLION))
    averages = smooth(curve(runs, variant, quantity))
    return float(averages[min(where, len(averages) - 1)])


def grows(runs: Runs, variant: str, quantity: Quantity) -> float:
    """The mean of the last third over that of the first third."""
    values = curve(runs, variant, quantity)
    return over(part(values, 2 / 3, 1), part(values, 0, 1 / 3))


def together(runs: Runs, variant: str, one: Quantity, other: Quantity) -> float:
    """The correlation of the moving averages of two quantities."""
    averages = np.stack([smooth(curve(runs, variant, each)) for each in (one, other)])
    there = averages[:, np.isfinite(averages).all(0)]
    return float(np.corrcoef(there)[0, 1]) if there.std(1).all() else float("nan")


def over(one: float, other: float) -> float:
    """One over the other; infinite if the other is 0, NaN if both are."""
    return one / other if other else math.inf if one else math.nan
