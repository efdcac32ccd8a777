"""Small trainers whose episodes are soon terminated or truncated, and what they collect."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from outlast.training.base.config import TrainingConfig
from outlast.training.policies.rows import Observed, PaddedRows, Rows
from outlast.training.ppo.rollout import Rollout
from outlast.training.ppo.trainer import Trainer
from tests.helpers.execution_modes import short

WORLDS, STEPS = 6, 40  # steps of each world in a rollout
SHORT = short("teams_3").replace(ending_limit=22)
SETTINGS = {"batch_size": 96, "n_epochs": 3}  # so that an update is quick


def make(preset: str = "original", **options: Any) -> Trainer:
    """A trainer of `SHORT`. options: Those of TrainingConfig, and numbers of PPO to change or add to SETTINGS."""
    known, threads = TrainingConfig.__dataclass_fields__.keys(), options.pop("threads", 1)
    given = {"scenario": SHORT, "worlds": WORLDS, "rollout": WORLDS * STEPS, "seed": 5, "preset": preset}
    given |= {name: value for name, value in options.items() if name in known}
    settings = SETTINGS | {name: value for name, value in options.items() if name not in known}
    return Trainer(TrainingConfig(**given, settings=settings), threads)


def doubled(seen: Observed) -> Observed:
    """The same observations in float64."""
    if isinstance(seen, PaddedRows):
        return PaddedRows(seen.packed.double(), seen.layout)
    return Rows(seen.own.double(), seen.entities.double(), seen.count.clone())


def in_float64(rollout: Rollout) -> Rollout:
    """The same rollout in float64, so that results made from it differ by less than the rounding of float32."""
    names = ("log_probs", "values", "advantages")
    seen = {form: doubled(each) for form, each in rollout.seen.items()}
    return replace(rollout, seen=seen, **{n: getattr(rollout, n).astype(np.float64) for n in names})


def weights(policy: torch.nn.Module) -> torch.Tensor:
    """A copy of all parameters, in one row."""
    return torch.nn.utils.parameters_to_vector(policy.parameters()).detach().clone()


def nearly(one: Any, other: Any, tolerance: float = 1e-6) -> None:
    """Check that the tensors of two lists differ by no more than the tolerance, relative or absolute."""
    for value, expected in zip(one, other, strict=True):
        torch.testing.assert_close(value.detach().cpu(), expected.detach().cpu(), rtol=tolerance, atol=tolerance)
