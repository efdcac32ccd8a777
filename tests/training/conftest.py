"""Runs that are trained once for a file; without PyTorch, only tests of files that need none."""

import functools
import importlib.util
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

WITHOUT = ("test_plot.py", "test_run_statistics.py")  # need no PyTorch
INSTALLED = all(map(importlib.util.find_spec, ("torch", "tensorboard")))  # outlast[train]


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out files of tests that need what is not installed."""
    needs = collection_path.name.startswith("test_") and collection_path.name not in WITHOUT
    return True if needs and not INSTALLED else None


@pytest.fixture(autouse=INSTALLED)
def one_thread(one_torch_thread: None) -> None:
    """Let PyTorch compute on one thread, see one_torch_thread."""


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
