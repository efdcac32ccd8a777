"""Results in the JSON format of marl-eval (Gorsane et al., 2022, arXiv:2209.10485), for its and BenchMARL's plots.

{environment: {task: {algorithm: {"seed_0": {"step_0": {"step_count": ..., metric: [...]}, "absolute_metrics": ...}}}}}
"""

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..base.errors import TrainingError

COUNT, ABSOLUTE = "step_count", "absolute_metrics"
Metrics = Mapping[str, float | Sequence[float]]  # by name: a value, or a value for each evaluation episode


def marl_eval_json(environment: str, runs: Mapping[tuple[str, str, int], Mapping[int | str, Metrics]]) -> str:
    """Return the results as JSON text, in order of task, algorithm and seed.

    marl-eval needs complete tables, and ignores case in names. Results that it would misread raise an error.

    Args:
        environment: Name of the environment of the tasks.
        runs: By task, algorithm and seed of training: the metrics of each evaluation, by agent-steps; and as
            "absolute_metrics" those of the best policy, evaluated anew (section 4 of the paper). Every algorithm must
            have the same seeds in every task; all runs must have equally many evaluations, with the same metrics.

    Raises:
        TrainingError: A run is missing, or its evaluations, metrics, names or numbers do not fit.
    """
    if not runs:
        raise TrainingError("runs for marl-eval are empty: at least one is required")
    tasks, algorithms, seeds = (dict.fromkeys(names) for names in zip(*runs, strict=True))
    first = next(iter(runs.values()))
    for names in (tasks, algorithms, first.get(ABSOLUTE, ())):
        if wrong := [name for name in names if "," in name or COUNT in name]:
            raise TrainingError(f"{wrong[0]}: marl-eval cannot read a name that contains a comma or {COUNT!r}")
        if len({name.lower() for name in names}) < len(names):
            raise TrainingError(f"{', '.join(names)}: two are the same name for marl-eval, which ignores case")
    nested: dict[str, Any] = {environment: {}}
    for task, algorithm, seed in itertools.product(*map(sorted, (tasks, algorithms, seeds))):
        where, run = f"{task}, {algorithm}, seed {seed}", runs.get((task, algorithm, seed), {})
        if ABSOLUTE not in run or not 1 < len(run) == len(first):
            raise TrainingError(f"{where} has {len(run)} evaluations: all need equally many, and {ABSOLUTE}")
        steps = sorted(count for count in run if isinstance(count, int))
        content = {f"step_{k}": {COUNT: count} | _numbers(where, run[count], first) for k, count in enumerate(steps)}
        content[ABSOLUTE] = _numbers(where, run[ABSOLUTE], first)
        nested[environment].setdefault(task, {}).setdefault(algorithm, {})[f"seed_{seed}"] = content
    return json.dumps(nested, indent=1, allow_nan=False) + "\n"


def _numbers(where: str, metrics: Metrics, first: Mapping[int | str, Metrics]) -> dict[str, Any]:
    if metrics.keys() != first[ABSOLUTE].keys():
        raise TrainingError(f"{where} has metrics {sorted(metrics)}: expected {sorted(first[ABSOLUTE])}")
    found = {name: np.atleast_1d(np.asarray(values, np.float64)) for name, values in metrics.items()}
    for name, values in found.items():
        if not values.size or not np.isfinite(values).all():
            raise TrainingError(f"{where}: {name} = {metrics[name]}: expected numbers")
    return {name: values.tolist() for name, values in found.items()}
