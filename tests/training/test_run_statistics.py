"""Statistics over runs: against rliable, hand-computed cases and known distributions; and results for marl-eval."""

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest

from outlast.training.base import statistics
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark.marl_eval import marl_eval_json
from tests.data import rliable_values

NAMES = ("mean", "median", "iqm", "probability_of_improvement")
FUNCTIONS = {name: getattr(statistics, name) for name in NAMES}
iqm, mean, median = statistics.iqm, statistics.mean, statistics.median
performance_profile, stratified_bootstrap = statistics.performance_profile, statistics.stratified_bootstrap
FUNCTIONS["performance_profile"] = lambda scores: performance_profile(scores, rliable_values.THRESHOLDS)


def compared(expected: dict[str, Any], scores: dict[str, Any], reps: int, tolerance: float) -> None:
    """Compare all values with rliable's, and ends of intervals to a tolerance in parts of their width."""
    for names, found in expected.items():
        given = [dict(enumerate(np.asarray(scores[name]).T)) for name in names.split(", ")]
        for name, (value, low, high) in found.items():
            ours = stratified_bootstrap(FUNCTIONS[name], *given, reps=reps)
            assert np.atleast_1d(ours.value) == pytest.approx(np.array(value)), (names, name)
            close = tolerance * (np.array(high) - low) + 1e-12
            assert (np.abs(np.array([ours.low - low, ours.high - high])) <= close).all(), (names, name, ours)


def test_values_and_intervals_are_those_of_rliable() -> None:
    """tests/data/rliable_values.py makes the file."""
    kept = json.loads(rliable_values.FILE.read_text())
    compared(kept["values"], kept["scores"], 20_000, 0.04)


def test_every_task_weighs_the_same_whatever_its_runs() -> None:
    uneven = {"a": [1, 3], "b": [2, 2, 8, 8]}
    assert (mean(uneven), median(uneven)) == (3.5, 3.5)
    assert iqm(uneven) == iqm({"a": [1, 1, 3, 3], "b": [2, 2, 8, 8]}) == (2 + 2 + 3 + 3) / 4
    assert performance_profile(uneven, [0, 2, 5, 8]).tolist() == [1, 0.5, 0.25, 0]
    assert statistics.probability_of_improvement(uneven, {"b": [8], "a": [2, 2, 2]}) == (0.5 + 0.25) / 2


def test_the_interval_is_that_of_all_resamplings() -> None:
    values = [0.1, 0.2, 0.4, 0.8, 0.9]
    every = [np.mean(drawn) for drawn in itertools.product(values, repeat=5)]
    assert statistics.interval(values, reps=100_000) == pytest.approx(np.quantile(every, (0.025, 0.975)), abs=0.01)
    assert statistics.interval([0.1, 0.9, 0.4]) == pytest.approx((0.1, 0.9))  # from the lowest to the highest
    assert statistics.interval([0.5, 0.5]) == (0.5, 0.5)
    assert statistics.interval([0.5]) is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: iqm({}), "scores are empty"),
        (lambda: iqm({"a": []}), "a: scores: expected one or more numbers"),
        (lambda: iqm({"a": ["high"]}), "a: scores: expected numbers"),
        (lambda: mean({"a": [0.5, 0.5], "b": [0.1, math.nan]}), r"b: scores: number 1 \(from 0 on\) is nan"),
        (lambda: mean(np.zeros((3, 2))), r"expected those of all runs by task, not a ndarray; of an array \(runs, ta"),
        (
            lambda: statistics.probability_of_improvement({"a": [1], "b": [1]}, {"a": [1]}),
            "only one side has scores of b",
        ),
        (lambda: performance_profile({"a": [1]}, [[1]]), r"thresholds of shape \(1, 1\)"),
        (lambda: stratified_bootstrap(mean, {"a": [1, 2], "b": [1]}), "b has one run: an interval over runs takes two"),
        (lambda: stratified_bootstrap(mean, {"a": [[1, 2]]}), r"a: scores of shape \(1, 2\): expected one number of"),
        (lambda: stratified_bootstrap(mean, {"a": [1, 2]}, reps=0), "reps = 0: expected"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        call()


def run_metrics(task: str, algorithm: str, seed: int) -> dict[Any, Any]:
    base = 0.1 * seed + (0.5 if algorithm == "fast" else 0.0) + (0.2 if task == "teams_2" else 0.0)
    steps = {10_000_000: {"wins": [base, base], "length": 90}, 5_000_000: {"wins": [base - 0.1, base], "length": 80}}
    return {**steps, "absolute_metrics": {"wins": [base, base + 0.2], "length": 100}}


PLANS = [*itertools.product(("teams_2", "ffa_2"), ("fast", "Scaled"), (1, 0))]
RUNS = {names: run_metrics(*names) for names in PLANS}
ONE = RUNS[PLANS[0]]


def test_what_is_written() -> None:
    written = json.loads(marl_eval_json("outlast", RUNS))
    found = {task: {name: [*runs] for name, runs in each.items()} for task, each in written["outlast"].items()}
    assert found == {k: {n: ["seed_0", "seed_1"] for n in ("Scaled", "fast")} for k in ("ffa_2", "teams_2")}
    assert written["outlast"]["ffa_2"]["fast"]["seed_0"] == {
        "step_0": {"step_count": 5_000_000, "wins": [0.4, 0.5], "length": [80]},
        "step_1": {"step_count": 10_000_000, "wins": [0.5, 0.5], "length": [90]},
        "absolute_metrics": {"wins": [0.5, 0.7], "length": [100]},
    }
    assert marl_eval_json("outlast", dict(reversed(RUNS.items()))) == marl_eval_json("outlast", RUNS)


@pytest.mark.parametrize(
    ("runs", "message"),
    [
        ({}, "runs for marl-eval are empty"),
        ({names: RUNS[names] for names in PLANS[1:]}, "teams_2, fast, seed 1 has 0 evaluations"),
        ({("ffa_2", "fast", 0): ONE, ("ffa_2", "Fast", 0): ONE}, "fast, Fast: two are the same name"),
        ({("ffa_2", "fast, big", 0): ONE}, "cannot read a name that contains a comma"),
        ({PLANS[0]: {"absolute_metrics": {"wins": 1}}}, "teams_2, fast, seed 1 has 1 evaluations"),
        ({PLANS[0]: {1: {"wins": 1}}}, "teams_2, fast, seed 1 has 1 evaluations: all need equally many, and absolute_"),
        ({PLANS[0]: {**ONE, "absolute_metrics": {"wins": 1}}}, r"has metrics \['length', 'wins'\]: expected \['w"),
        ({PLANS[0]: {**ONE, "absolute_metrics": {"wins": math.nan, "length": 1}}}, "seed 1: wins = nan"),
    ],
)
def test_what_it_would_misread_is_refused(runs: Any, message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        marl_eval_json("outlast", runs)
