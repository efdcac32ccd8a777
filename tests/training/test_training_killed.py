"""Runs that were killed early, and what says what a run is: see also killing, which kills them."""

import json
from pathlib import Path

import pytest

from outlast.envs.errors import TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training import checkpoint  # noqa: E402
from outlast.training.train import Run  # noqa: E402
from tests.training.test_training_run import EACH, SHORT, names, plan, points  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_again(tmp_path: Path) -> None:
    Run(plan(2 * EACH), tmp_path / "whole").go()
    begun = Run(plan(2 * EACH), tmp_path / "parts")  # and killed
    begun.model.logger.close()
    (tmp_path / "parts/.log.csv-0123abcd.tmp").write_text("half")
    with (tmp_path / "parts/log.csv").open("a") as log:
        log.write("train/loss,384,0.5\ntrain/lo")
    assert json.loads((tmp_path / "parts/run.json").read_text())["plan"]["seed"] == 3
    with pytest.raises(TrainingError, match="is not empty: go on with --resume"):
        Run(plan(2 * EACH), tmp_path / "parts")
    with pytest.raises(TrainingError, match="was begun with seed = 3, not 4"):
        Run(plan(2 * EACH, seed=4), tmp_path / "parts", resume=True)
    with pytest.raises(TrainingError, match=r"another scenario .*: agents_health is 10 there and 11 here"):
        Run(plan(2 * EACH, scenario=SHORT.replace(agents_health=11)), tmp_path / "parts", resume=True)
    Run(plan(2 * EACH), tmp_path / "parts", resume=True).go()
    assert points(tmp_path / "parts") == points(tmp_path / "whole")
    assert not list(tmp_path.glob("*/*.tmp"))


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_with_nothing_but_a_draft_is_empty(tmp_path: Path, resume: bool) -> None:
    (tmp_path / ".run.json-0123abcd.tmp").write_text("half")
    Run(plan(EACH), tmp_path, resume=resume).go()
    assert names(tmp_path) == [checkpoint.NAME.format(EACH)]
    assert not list(tmp_path.glob("*.tmp"))


def test_run_json_says_what_a_checkpoint_says(tmp_path: Path) -> None:
    Run(plan(EACH), tmp_path).go()
    told = json.loads((tmp_path / "run.json").read_text())
    saved = checkpoint.about(checkpoint.read(checkpoint.newest(tmp_path)))
    assert told == {key: saved[key] for key in ("plan", "scenario")}
    (tmp_path / "run.json").write_text("{")
    (tmp_path / checkpoint.NAME.format(EACH)).unlink()
    with pytest.raises(TrainingError, match=r"run.json does not say what the run is"):
        Run(plan(EACH), tmp_path, resume=True)
