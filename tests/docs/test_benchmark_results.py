"""The results of the benchmark that are kept: tables are made of them, and they are what they claim."""

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.envs.cli.main import main
from outlast.training.benchmark import scores, table

KEPT = Path(__file__).parents[2] / "results" / "benchmark"


def test_tables_are_those_of_the_kept_results() -> None:
    """To update them: outlast benchmark table results/benchmark"""
    found = scores.scores(KEPT)
    assert (KEPT / "table.md").read_text() == table.markdown(found)
    assert (KEPT / "table.csv").read_text() == table.as_csv(found)


@pytest.mark.nightly
def test_kept_results_are_as_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing but what is not kept is missing: of each agent and task, the recording and the policy of one seed are."""
    assert main(["benchmark", "verify", str(KEPT), "--quiet", "--allow-missing"]) == 0
    assert " checks: 24 as recorded, 0 wrong, " in capsys.readouterr().out
