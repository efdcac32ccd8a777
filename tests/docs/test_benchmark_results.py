"""The accepted entries of the benchmark: tables are made of them, and they are what they claim."""

import contextlib
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.envs.cli.main import main
from outlast.training.benchmark import manifest, scores, table
from outlast.training.benchmark.verify import opened

KEPT = Path(__file__).parents[2] / "results" / "benchmark"
ENTRIES = sorted(KEPT.glob("*.zip"))


@pytest.mark.skipif(not KEPT.is_dir(), reason="results are not part of this archive")
def test_tables_are_those_of_the_accepted_entries() -> None:
    """To update them: outlast benchmark table results/benchmark/*.zip --out results/benchmark"""
    with contextlib.ExitStack() as stack:
        found = scores.scores([manifest.read(stack.enter_context(opened(path))) for path in ENTRIES])
    assert (KEPT / "table.md").read_text() == table.markdown(found)
    assert (KEPT / "table.csv").read_text() == table.as_csv(found)


@pytest.mark.nightly
@pytest.mark.parametrize("path", ENTRIES, ids=lambda path: path.stem)
def test_accepted_entries_are_as_recorded(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "verify", str(path), "--quiet", "--allow-missing"]) == 0
    assert " 0 wrong, " in capsys.readouterr().out
