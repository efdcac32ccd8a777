"""Tiny runs: how they are trained, what they log and which files they leave."""

import functools
from pathlib import Path
from typing import Any

from outlast.envs.rollout.saved import newest
from outlast.training.base.config import TrainingConfig
from outlast.training.base.curves import read_log
from outlast.training.cli import train as command
from outlast.training.policies import checkpoint
from tests.conftest import call
from tests.helpers.execution_modes import short

SHORT = short("ffa_1")
EACH = 8 * 24 * 2  # agent-steps of a rollout
SETTINGS = {"original": {"batch_size": 64, "n_epochs": 3, "target_kl": 0.0}}
OTHERS = {"batch_size": 64, "anneal_lr": False}  # settings of other presets: runs of any length begin in the same way
outlast_train = functools.partial(call, command)


def config(steps: int, preset: str = "original", **changes: Any) -> TrainingConfig:
    """The plan of a run of `steps` agent-steps, with a checkpoint after every second rollout."""
    given = {"scenario": SHORT, "steps": steps, "worlds": 8, "rollout": 8 * 24, "every": 2 * EACH, "threads": 1}
    return TrainingConfig(preset=preset, **(given | {"seed": 3, "settings": SETTINGS.get(preset, OTHERS)} | changes))


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """The points of a log, but for times."""
    return {tag: values for tag, values in read_log(folder / "log.csv").items() if not tag.startswith("time/")}


def names(folder: Path) -> list[str]:
    """The checkpoints of a run."""
    return sorted(path.name for path in folder.glob("*.zip"))


def assert_same(one: Path, other: Path) -> None:
    """Check that two runs logged the same, and that their last checkpoints hold the same, bit for bit."""
    assert points(one) == points(other)
    files = [checkpoint.read_checkpoint(newest(folder)) for folder in (one, other)]
    assert files[0].keys() == files[1].keys()
    assert [name for name in files[0] if files[0][name] != files[1][name]] == []
