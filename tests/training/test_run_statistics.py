"""Statistics over runs: against rliable, against hand-computed cases, and against known distributions."""

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest

from outlast.training.base import statistics
from outlast.training.base.errors import TrainingError
from outlast.training.base.statistics import (
    iqm,
    mean,
    median,
    performance_profile,
    probability_of_improvement,
    stratified_bootstrap,
)
from tests.data import rliable_values

FUNCTIONS = {
    "mean": mean,
    "median": median,
    "iqm": iqm,
    "performance_profile": lambda scores: performance_profile(scores, rliable_values.THRESHOLDS),
    "probability_of_improvement": probability_of_improvement,
}


def by_task(scores: Any) -> dict[Any, Any]:
    return dict(enumerate(np.asarray(scores).T))


def compared(expected: dict[str, Any], scores: dict[str, Any], reps: int, tolerance: float) -> None:
    """Compare all values with rliable's, and ends of intervals to a tolerance in parts of their width."""
    for names, found in expected.items():
        given = [by_task(scores[name]) for name in names.split(", ")]
        for name, (value, low, high) in found.items():
            ours = stratified_bootstrap(FUNCTIONS[name], *given, reps=reps)
            assert np.atleast_1d(ours.value) == pytest.approx(np.array(value)), (names, name)
            close = tolerance * (np.array(high) - low) + 1e-12
            assert (np.abs(np.array([ours.low - low, ours.high - high])) <= close).all(), (names, name, ours)


def test_values_and_intervals_are_those_of_rliable() -> None:
    """tests/data/rliable_values.py makes the file."""
    kept = json.loads(rliable_values.FILE.read_text())
    compared(kept["values"], kept["scores"], 20_000, 0.04)


def test_values_are_those_of_the_installed_rliable() -> None:
    pytest.importorskip("rliable.library", reason="needs rliable and pandas < 3", exc_type=ImportError)
    compared(rliable_values.values(500), rliable_values.scores(), 20_000, 0.25)


# ---- by hand


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end() -> None:
    assert iqm({"a": [9, 1, 2, 3]}) == 2.5
    assert iqm({"a": [1, 2, 3, 4, 5, 6, 100]}) == 4  # 1 of 7 at each end, as in scipy.stats.trim_mean
    assert iqm({"a": [1, 9], "b": [2, 4]}) == 3  # of all runs of all tasks
    assert iqm({"a": [7]}) == 7


def test_every_task_weighs_the_same_whatever_its_runs() -> None:
    uneven = {"a": [1, 3], "b": [2, 2, 8, 8]}
    assert (mean(uneven), median(uneven)) == (3.5, 3.5)
    assert iqm(uneven) == iqm({"a": [1, 1, 3, 3], "b": [2, 2, 8, 8]}) == (2 + 2 + 3 + 3) / 4
    assert performance_profile(uneven, [0, 2, 5, 8]).tolist() == [1, 0.5, 0.25, 0]
    assert probability_of_improvement(uneven, {"b": [8], "a": [2, 2, 2]}) == (0.5 + 0.25) / 2


def test_leading_axes_are_kept() -> None:
    rng = np.random.default_rng(0)
    many = {"a": rng.random((6, 5)), "b": rng.random((6, 3))}
    one_by_one = [{task: each[k] for task, each in many.items()} for k in range(6)]
    for name in ("mean", "median", "iqm", "performance_profile"):
        assert FUNCTIONS[name](many) == pytest.approx(np.array([FUNCTIONS[name](one) for one in one_by_one])), name
    improvement = probability_of_improvement(many, one_by_one[0])
    assert improvement == pytest.approx([probability_of_improvement(one, one_by_one[0]) for one in one_by_one])


def test_the_interval_is_that_of_all_resamplings() -> None:
    values = [0.1, 0.2, 0.4, 0.8, 0.9]
    every = [np.mean(drawn) for drawn in itertools.product(values, repeat=5)]
    assert statistics.interval(values, reps=100_000) == pytest.approx(np.quantile(every, (0.025, 0.975)), abs=0.01)
    assert statistics.interval([0.1, 0.9, 0.4]) == pytest.approx((0.1, 0.9))  # from the lowest to the highest
    assert statistics.interval([0.5, 0.5]) == (0.5, 0.5)
    assert statistics.interval([0.5]) is None


def test_of_many_runs_the_interval_is_the_normal_one() -> None:
    tasks = {k: np.random.default_rng(k).normal(k, 1, 100) for k in range(4)}
    error = math.sqrt(sum(each.var() / 100 for each in tasks.values())) / 4  # tasks are strata: they do not scatter
    value, low, high = stratified_bootstrap(mean, tasks, reps=20_000)
    assert (value - low, high - value) == pytest.approx((1.96 * error, 1.96 * error), rel=0.04)


def test_the_seed_decides() -> None:
    scores = {"a": [0.1, 0.4, 0.5, 0.7, 0.9], "b": [0.3, 0.2, 0.6]}
    assert stratified_bootstrap(iqm, scores, seed=3, reps=100) == stratified_bootstrap(iqm, scores, seed=3, reps=100)
    assert stratified_bootstrap(iqm, scores, seed=3, reps=100) != stratified_bootstrap(iqm, scores, seed=4, reps=100)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: iqm({}), "there are no scores"),
        (lambda: iqm({"a": []}), "a: scores: expected one or more numbers"),
        (lambda: iqm({"a": 0.5}), "a: scores: expected one or more numbers"),
        (lambda: iqm({"a": ["high"]}), "a: scores: expected numbers"),
        (lambda: mean({"a": [0.5, 0.5], "b": [0.1, math.nan]}), r"b: scores: number 1 \(from 0 on\) is nan"),
        (lambda: mean(np.zeros((3, 2))), r"expected those of all runs by task, not a ndarray; of an array \(runs, ta"),
        (lambda: probability_of_improvement({"a": [1], "b": [1]}, {"a": [1]}), "only one of two has scores of b"),
        (lambda: performance_profile({"a": [1]}, []), "thresholds: expected one or more numbers"),
        (lambda: performance_profile({"a": [1]}, [[1]]), r"thresholds of shape \(1, 1\)"),
        (lambda: stratified_bootstrap(mean, {"a": [1, 2], "b": [1]}), "b has one run: an interval over runs takes two"),
        (lambda: stratified_bootstrap(mean, {"a": [[1, 2]]}), r"a: scores of shape \(1, 2\): expected one number of"),
        (lambda: stratified_bootstrap(mean, {"a": [1, 2]}, reps=0), "reps = 0: expected"),
        (lambda: statistics.interval([]), "expected one or more numbers"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        call()
