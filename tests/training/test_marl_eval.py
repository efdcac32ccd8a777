"""Results for marl-eval: what is written, what is refused, and what its own reader makes of it."""

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest

from outlast.training.base.errors import TrainingError
from outlast.training.benchmark.marl_eval import RunMetrics, marl_eval_json


def run(task: str, algorithm: str, seed: int) -> RunMetrics:
    base = 0.1 * seed + (0.5 if algorithm == "fast" else 0.0) + (0.2 if task == "teams_2" else 0.0)
    steps = {10_000_000: {"wins": [base, base], "length": 90}, 5_000_000: {"wins": [base - 0.1, base], "length": 80}}
    return RunMetrics(task, algorithm, seed, steps, {"wins": [base, base + 0.2], "length": 100})


RUNS = [run(task, name, seed) for task in ("teams_2", "ffa_2") for name in ("fast", "Scaled") for seed in (1, 0)]


def test_what_is_written() -> None:
    written = json.loads(marl_eval_json("outlast", RUNS))
    assert {task: {name: [*runs] for name, runs in each.items()} for task, each in written["outlast"].items()} == {
        task: {"Scaled": ["seed_0", "seed_1"], "fast": ["seed_0", "seed_1"]} for task in ("ffa_2", "teams_2")
    }
    assert written["outlast"]["ffa_2"]["fast"]["seed_0"] == {
        "step_0": {"step_count": 5_000_000, "wins": [0.4, 0.5], "length": [80]},
        "step_1": {"step_count": 10_000_000, "wins": [0.5, 0.5], "length": [90]},
        "absolute_metrics": {"wins": [0.5, 0.7], "length": [100]},
    }
    assert marl_eval_json("outlast", RUNS[::-1]) == marl_eval_json("outlast", RUNS)


def test_marl_eval_reads_it(capsys: pytest.CaptureFixture[str]) -> None:
    reader = pytest.importorskip("marl_eval.utils.data_processing_utils", reason="needs id-marl-eval")
    from marl_eval.utils.diagnose_data_errors import DiagnoseData

    content = json.loads(marl_eval_json("outlast", RUNS))
    assert set(DiagnoseData(content).check_data()["outlast"].values()) == {True}
    processed = reader.data_process_pipeline(content, [])
    assert processed["extra"]["evaluation_interval"] == {"outlast": 5_000_000}
    final, steps = reader.create_matrices_for_rliable(processed, "outlast", [])
    assert final["mean_wins"]["fast"] == pytest.approx(np.array([[0.6, 0.8], [0.7, 0.9]]))  # runs, tasks
    assert steps["mean_wins"]["scaled"][..., 1] == pytest.approx(np.array([[0, 0.2], [0.1, 0.3]]))
    assert "issue" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("runs", "message"),
    [
        ([], "there are no runs"),
        (RUNS[1:], "seed 1 of fast in teams_2 is there 0 times"),
        ([*RUNS, RUNS[0]], "seed 1 of fast in teams_2 is there 2 times"),
        ([run("ffa_2", "fast", 0), run("ffa_2", "Fast", 0)], "Fast and fast are one name"),
        ([run("ffa_2", "fast, big", 0)], "no name with a comma"),
        ([dataclasses.replace(RUNS[0], steps={})], "teams_2, fast, seed 1 has 0 evaluations"),
        (
            [dataclasses.replace(RUNS[0], absolute={"wins": 1})],
            r"has metrics \['length', 'wins'\]: expected \['wins'\]",
        ),
        ([dataclasses.replace(RUNS[0], absolute={"wins": math.nan, "length": 1})], "absolute metrics: wins = nan"),
    ],
)
def test_what_it_would_misread_is_refused(runs: list[Any], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        marl_eval_json("outlast", runs)
