"""PPO's hyperparameters: those of the authors' runs, and which others are possible."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from outlast.ecs.kernels.errors import meant
from outlast.ecs.kernels.integers import as_whole

from .errors import TrainingError

TRUTHS = {"true": True, "1": True, "false": False, "0": False}
PARSERS: dict[type, Callable[[str], Any]] = {
    bool: lambda text: TRUTHS[text.lower()],
    int: lambda text: as_whole(float(text)),  # 1e4 is whole, too
    float: float,
    str: str,
}


@dataclass(frozen=True)
class Hyperparameters:
    """The numbers of PPO; the defaults are those of the authors' runs.

    Attributes:
        learning_rate: Learning rate of Adam.
        anneal_lr: Whether the learning rate falls to 0 along the run, in proportion to the steps that are left.
        batch_size: About how many samples a minibatch has; the samples of a rollout are shared out evenly.
        n_epochs: How often every sample is used, at most.
        gamma: Discount of a step.
        gae_lambda: How far advantages look ahead, from 0 to 1.
        clip_range: How far the ratio of probabilities may move away from 1 before it is clipped.
        ent_coef: Weight of the entropy in the loss.
        vf_coef: Weight of the values in the loss.
        max_grad_norm: Norm that gradients are clipped to.
        target_kl: The update ends before a minibatch whose divergence is above 1.5 times this; 0: never.
        scale_rewards: Whether rewards are divided by the running standard deviation of their discounted sums, that of
            all agents, trained or not, including absent ones.
    """

    learning_rate: float = 3e-4
    anneal_lr: bool = False
    batch_size: int = 512
    n_epochs: int = 400  # a cap; the divergence ends most updates
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    ent_coef: float = 0.0
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    target_kl: float = 0.01
    scale_rewards: bool = False

    def __post_init__(self) -> None:
        """Raise TrainingError if a number has the wrong type, or is out of its range."""
        for name, kind in KINDS.items():
            value: Any = getattr(self, name)
            if kind is int:
                object.__setattr__(self, name, value := as_whole(value))
            words, fits = RANGES.get(name, ANY)
            kinds: Any = (float, int) if kind is float else kind
            if not isinstance(value, kinds) or isinstance(value, bool) != (kind is bool):
                raise TrainingError(f"{name}={value}: {example(name)} is needed")
            if not (fits(value) and value < math.inf):
                raise TrainingError(f"{name}={value}: a finite number {words} is needed")

    def changed(self, settings: Mapping[str, Any]) -> "Hyperparameters":
        """A copy with other settings. Raises TrainingError for unknown names and impossible values."""
        for name in settings:
            if name not in KINDS:
                raise TrainingError(f"PPO has no number '{name}'; {meant(name, KINDS)}")
        return replace(self, **settings)


KINDS: dict[str, type] = {each.name: type(each.default) for each in fields(Hyperparameters)}


Range = tuple[str, Callable[[float], bool]]  # in words, and as a test
ANY: Range = ("", lambda value: True)
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
    "target_kl": NOT_NEGATIVE,
}


def example(name: str) -> str:
    """Say what kind of value a hyperparameter has, in words."""
    if KINDS[name] is bool:
        return "true or false"
    return f"a {'whole ' * (KINDS[name] is int)}number like {getattr(Hyperparameters, name)}"


def parse_hyperparameters(texts: Iterable[str]) -> dict[str, Any]:
    """Parse hyperparameters from texts like "gamma=0.999". Raises TrainingError."""
    settings: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in settings:
            raise TrainingError(f"{text}: {name} is given twice; say one of them")
        try:
            settings[name] = PARSERS[KINDS.get(name, str)](value)
        except (ValueError, KeyError) as error:
            raise TrainingError(f"{text}: {example(name)} is needed") from error
    Hyperparameters().changed(settings)
    return settings
