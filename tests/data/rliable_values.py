"""Values of rliable on random scores: `python tests/data/rliable_values.py`, which rewrites rliable_values.json.

rliable 1.2.0 does not import beside pandas 3, so it takes an environment of its own:
python3 -m venv venv && venv/bin/pip install rliable==1.2.0 'pandas<3' 'numpy<2.3'
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

FILE = Path(__file__).with_suffix(".json")
SHAPES = {"ours": (5, 4), "theirs": (7, 4), "single": (7, 1)}  # runs, tasks
THRESHOLDS = [0.2, 0.5, 0.75]


def scores() -> dict[str, Any]:
    """Scores (runs, tasks), with ties."""
    rng = np.random.default_rng(0)
    return {name: rng.beta(2, 3 - 0.5 * k, shape).round(1) for k, (name, shape) in enumerate(SHAPES.items())}


def values(reps: int) -> dict[str, dict[str, list[Any]]]:
    """Value, lower and upper end of each statistic, by the scores that it is of."""
    from rliable import library, metrics

    np.random.seed(0)  # noqa: NPY002, rliable draws from this generator
    given, found = scores(), dict[str, dict[str, list[Any]]]()
    functions = {
        "mean": metrics.aggregate_mean,
        "median": metrics.aggregate_median,
        "iqm": metrics.aggregate_iqm,
        "performance_profile": lambda each: library.score_distributions(each, THRESHOLDS),
    }
    cases = dict.fromkeys(given, functions)
    pairs = {"ours, theirs": {"probability_of_improvement": metrics.probability_of_improvement}}
    for names, statistics in {**cases, **pairs}.items():
        arrays = [given[name] for name in names.split(", ")]
        for name, function in statistics.items():
            data = {"": arrays if len(arrays) > 1 else arrays[0]}
            value, ends = library.get_interval_estimates(data, lambda *x, f=function: np.atleast_1d(f(*x)), reps=reps)
            found.setdefault(names, {})[name] = [value[""].tolist(), *ends[""].tolist()]
    return found


if __name__ == "__main__":
    content = {"scores": {name: each.tolist() for name, each in scores().items()}, "values": values(10_000)}
    FILE.write_text(json.dumps(content, indent=1) + "\n")
