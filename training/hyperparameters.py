"""PPO's hyperparameters in the authors' runs, and the ranges that others may be from."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from .errors import TrainingError

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

Range = tuple[str, Callable[[float], bool]]  # in words, and as a rule
POSITIVE: Range = ("above 0", lambda value: value > 0)
NOT_NEGATIVE: Range = ("of at least 0", lambda value: value >= 0)
SHARE: Range = ("from 0 to 1", lambda value: 0 <= value <= 1)
RANGES: dict[str, Range] = {
    "learning_rate": POSITIVE,
    "batch_size": ("of at least 2", lambda value: value >= 2),  # advantages are normalised in each minibatch
    "n_epochs": ("of at least 1", lambda value: value >= 1),
    "gamma": SHARE,
    "gae_lambda": SHARE,
    "clip_range": POSITIVE,
    "ent_coef": NOT_NEGATIVE,
    "vf_coef": NOT_NEGATIVE,
    "max_grad_norm": POSITIVE,
    "target_kl": POSITIVE,
}


def check_ranges(hyperparameters: Mapping[str, Any]) -> None:
    """Refuse hyperparameters that are out of range. What is no number is Stable-Baselines3's to judge.

    Raises:
        TrainingError: One is out of its range.
    """
    for name, value in hyperparameters.items():
        if name in RANGES and isinstance(value, (int, float)):
            words, fits = RANGES[name]
            if not (fits(value) and value < math.inf):
                raise TrainingError(f"{name}={value}: a finite number {words} is needed")


def parse_hyperparameters(texts: Iterable[str]) -> dict[str, float]:
    """Hyperparameters out of texts like "gamma=0.999". Raises TrainingError."""
    numbers: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in PAPER:
            raise TrainingError(f"PPO has no number '{name}'; it has: {', '.join(PAPER)}")
        try:
            numbers[name] = type(PAPER[name])(value)
        except ValueError as error:
            raise TrainingError(f"{text}: a number like {PAPER[name]} is needed") from error
    check_ranges(numbers)
    return numbers
