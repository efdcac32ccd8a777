"""Runs that are trained once for a file."""

import functools
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """The folder of a run of so many rollouts, as tests.helpers.runs has them. It must stay as it is."""
    from outlast.training.runs.run import TrainingRun
    from tests.helpers.runs import EACH, config

    @functools.cache
    def trained(rollouts: int) -> Path:
        folder = tmp_path_factory.mktemp("whole") / "run"
        TrainingRun(config(rollouts * EACH), folder).train()
        return folder

    return trained


@pytest.fixture
def begun(whole: Callable[[int], Path], tmp_path: Path) -> Callable[..., Path]:
    """A copy of such a run, to go on with or to spoil."""
    return lambda rollouts, name="run": Path(shutil.copytree(whole(rollouts), tmp_path / name))
