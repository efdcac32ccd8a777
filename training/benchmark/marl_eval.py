"""Results in the JSON format of marl-eval (Gorsane et al., 2022, arXiv:2209.10485), for its and BenchMARL's plots.

{environment: {task: {algorithm: {"seed_0": {"step_0": {"step_count": ..., metric: [...]}, "absolute_metrics": ...}}}}}
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.errors import TrainingError

COUNT = "step_count"
Metrics = Mapping[str, float | Sequence[float]]  # by name: a value, or a value for each evaluation episode


@dataclass(frozen=True)
class RunMetrics:
    """Results of a run.

    Attributes:
        task: Name of the game.
        algorithm: Name without commas, which marl-eval cannot read.
        seed: Seed of training.
        steps: Metrics of each evaluation, by agent-steps of training.
        absolute: Metrics of its best policy, evaluated anew: the absolute metric of the paper, section 4.
    """

    task: str
    algorithm: str
    seed: int
    steps: Mapping[int, Metrics]
    absolute: Metrics


def marl_eval_json(environment: str, runs: Iterable[RunMetrics]) -> str:
    """Return the results as JSON text, in order of task, algorithm and seed.

    marl-eval needs complete tables, and ignores case in names. Results that it would misread raise an error.

    Args:
        environment: Name of the environment of the tasks.
        runs: At least one run. Every algorithm must have the same seeds in every task; all runs must have equally many
            evaluations, with the same metrics.

    Raises:
        TrainingError: A run is missing or given twice, or its evaluations, metrics, names or numbers do not fit.
    """
    ordered = sorted(runs, key=lambda run: (run.task, run.algorithm, run.seed))
    _check_complete(ordered)
    nested: dict[str, Any] = {}
    for run in ordered:
        entries = [_entry(run, f"step {count}", run.steps[count], {COUNT: count}) for count in sorted(run.steps)]
        content = {f"step_{k}": entry for k, entry in enumerate(entries)}
        content["absolute_metrics"] = _entry(run, "absolute metrics", run.absolute, {})
        nested.setdefault(run.task, {}).setdefault(run.algorithm, {})[f"seed_{run.seed}"] = content
    return json.dumps({environment: nested}, indent=1, allow_nan=False) + "\n"


def _entry(run: RunMetrics, where: str, metrics: Metrics, entry: dict[str, Any]) -> dict[str, Any]:
    for name, values in metrics.items():
        numbers = np.atleast_1d(np.asarray(values, np.float64))
        if not numbers.size or not np.isfinite(numbers).all():
            raise TrainingError(f"{_named(run)}, {where}: {name} = {values}: expected numbers")
        entry[name] = numbers.tolist()
    return entry


def _check_complete(runs: Sequence[RunMetrics]) -> None:
    if not runs:
        raise TrainingError("runs for marl-eval are empty: at least one is required")
    given = [(run.task, run.algorithm, run.seed) for run in runs]
    tasks, algorithms, seeds = (sorted(set(names)) for names in zip(*given, strict=True))
    metrics = sorted(runs[0].absolute)
    for names in (tasks, algorithms, metrics):
        _check_names(names)
    for task, algorithm, seed in ((t, a, s) for t in tasks for a in algorithms for s in seeds):
        if (count := given.count((task, algorithm, seed))) != 1:
            which = f"seed {seed} of {algorithm} in {task}"
            raise TrainingError(f"{which} occurs {count} times: marl-eval requires the same seeds once each")
    for run in runs:
        if not run.steps or len(run.steps) != len(runs[0].steps):
            expected = f"as many as {_named(runs[0])}, {len(runs[0].steps)}, and at least one"
            raise TrainingError(f"{_named(run)} has {len(run.steps)} evaluations: expected {expected}")
        for found in (*run.steps.values(), run.absolute):
            if sorted(found) != metrics:
                raise TrainingError(f"{_named(run)} has metrics {sorted(found)}: expected {metrics} in each evaluation")


def _check_names(names: Iterable[str]) -> None:
    """Raise TrainingError for names that marl-eval would confuse or misread."""
    seen: dict[str, str] = {}
    for name in names:
        if "," in name or COUNT in name:
            raise TrainingError(f"{name}: marl-eval cannot read a name that contains a comma or {COUNT!r}")
        if (other := seen.setdefault(name.lower(), name)) != name:
            raise TrainingError(f"{other} and {name} are the same name for marl-eval, which ignores case")


def _named(run: RunMetrics) -> str:
    return f"{run.task}, {run.algorithm}, seed {run.seed}"
