"""The numbers of PPO that the authors' runs had."""

from collections.abc import Iterable
from typing import Any

from outlast.envs.errors import TrainingError

ROLLOUT = 16384  # environment steps
PAPER: dict[str, Any] = {
    "learning_rate": 3e-4,
    "batch_size": 512,
    "n_epochs": 400,  # a cap; the divergence ends most updates
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "clip_range": 0.2,
    "ent_coef": 0.0,
    "vf_coef": 0.5,
    "max_grad_norm": 0.5,
    "target_kl": 0.01,  # Stable-Baselines3 stops at 1.5 times that
}


def changed(texts: Iterable[str]) -> dict[str, float]:
    """Numbers of PPO out of texts like "gamma=0.999". Raises TrainingError."""
    numbers: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in PAPER:
            raise TrainingError(f"PPO has no number '{name}'; it has: {', '.join(PAPER)}")
        try:
            numbers[name] = type(PAPER[name])(value)
        except ValueError as error:
            raise TrainingError(f"{text}: a number like {PAPER[name]} is needed") from error
    return numbers
