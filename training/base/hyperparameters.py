"""PPO's hyperparameters: those of the authors' runs, and their ranges."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any

from outlast.ecs.kernels.errors import meant
from outlast.ecs.kernels.integers import as_whole

from .errors import TrainingError

TOGETHER = ("gamma", "gae_lambda", "scale_rewards")  # these act on rollouts, so all policies of a run share them
TRUTHS = {"true": True, "1": True, "false": False, "0": False}
PARSERS: dict[type, Callable[[str], Any]] = {
    bool: lambda text: TRUTHS[text.lower()],
    int: lambda text: as_whole(float(text)),  # 1e4 is an integer, too
    float: float,
    str: str,
}


Range = tuple[str, Callable[[float], bool]]  # in words, and as a test
ANY: Range = ("", lambda value: True)
POSITIVE: Range = ("above 0", lambda value: value > 0)
SHARE: Range = ("from 0 to 1", lambda value: 0 <= value <= 1)


def at_least(least: int) -> Range:
    """Return the range of numbers >= `least`."""
    return f"of at least {least}", lambda value: value >= least


def number(default: Any, text: str, allowed: Range = ANY) -> Any:
    """Return the field of a hyperparameter, with its description and range."""
    return field(default=default, metadata={"text": text, "range": allowed})


@dataclass(frozen=True)
class Hyperparameters:
    """The numbers of PPO; the defaults are those of the authors' runs."""

    learning_rate: float = number(3e-4, "learning rate of Adam", POSITIVE)
    anneal_lr: bool = number(
        False, "whether the learning rate falls to 0 along the run, in proportion to the steps that are left"
    )
    batch_size: int = number(  # of at least 2, as advantages are normalised in each minibatch
        512, "approximate samples of a minibatch; the samples of a rollout are divided evenly", at_least(2)
    )
    n_epochs: int = number(
        400, "maximum passes over the samples; the divergence ends most updates earlier", at_least(1)
    )
    gamma: float = number(0.99, "discount of a step", SHARE)
    gae_lambda: float = number(0.95, "how far advantages look ahead, from 0 to 1", SHARE)
    clip_range: float = number(
        0.2, "how far the ratio of probabilities may move away from 1 before it is clipped", POSITIVE
    )
    ent_coef: float = number(0.0, "weight of the entropy in the loss", at_least(0))
    vf_coef: float = number(0.5, "weight of the values in the loss", at_least(0))
    max_grad_norm: float = number(0.5, "norm that gradients are clipped to", POSITIVE)
    target_kl: float = number(
        0.01, "the update ends before a minibatch whose divergence is above 1.5 times this; 0: never", at_least(0)
    )
    scale_rewards: bool = number(
        False,
        "whether rewards are divided by the running standard deviation of their discounted sums, that of all agents, "
        "trained or not, including absent ones",
    )

    def __post_init__(self) -> None:
        """Raise TrainingError if a number has the wrong type, or is out of its range."""
        for name, kind in KINDS.items():
            value: Any = getattr(self, name)
            if kind is int:
                object.__setattr__(self, name, value := as_whole(value))
            words, fits = RANGES[name]
            kinds: Any = (float, int) if kind is float else kind
            if not isinstance(value, kinds) or isinstance(value, bool) != (kind is bool):
                raise TrainingError(f"{name}={value}: {example(name)} is needed")
            if not (fits(value) and value < math.inf):
                raise TrainingError(f"{name}={value}: a finite number {words} is needed")

    def by_policy(
        self, settings: Mapping[str, Any], own: Mapping[str, "Hyperparameters"] = MappingProxyType({})
    ) -> dict[str, "Hyperparameters"]:
        """Return copies with other settings by the name of the policy, "" for those that are not named.

        settings: "ent_coef" for all policies, "seeker:ent_coef" for one of them. own: The numbers of policies to which
        settings are applied instead of these. Raises TrainingError as `changed`.
        """
        given = dict[str, dict[str, Any]]({name: {} for name in ("", *own)})
        for name, value in settings.items():
            policy, _, number = name.rpartition(":")
            if policy and number in TOGETHER:
                raise TrainingError(f"{name}: all policies share {', '.join(TOGETHER)}; set {number} without a policy")
            given.setdefault(policy, {})[number] = value
        return {name: own.get(name, self).changed(given[""] | changes) for name, changes in given.items()}

    def changed(self, settings: Mapping[str, Any]) -> "Hyperparameters":
        """Return a copy with some settings changed. Raises TrainingError for unknown names and impossible values."""
        for name in settings:
            if name not in KINDS:
                raise TrainingError(f"PPO has no hyperparameter '{name}'; {meant(name, KINDS)}")
        return replace(self, **settings)


KINDS: dict[str, type] = {each.name: type(each.default) for each in fields(Hyperparameters)}
RANGES: dict[str, Range] = {each.name: each.metadata["range"] for each in fields(Hyperparameters)}


def example(name: str) -> str:
    """Describe the type of a hyperparameter's value in words."""
    if KINDS[name] is bool:
        return "true or false"
    return f"a {'whole ' * (KINDS[name] is int)}number like {getattr(Hyperparameters, name)}"


def parse_hyperparameters(texts: Iterable[str]) -> dict[str, Any]:
    """Parse hyperparameters from texts like "gamma=0.999" and "seeker:ent_coef=0.01". Raises TrainingError."""
    settings: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        kind = name.rpartition(":")[2]
        if name in settings:
            raise TrainingError(f"{text}: {name} is given twice; remove one of them")
        try:
            settings[name] = PARSERS[KINDS.get(kind, str)](value)
        except (ValueError, KeyError) as error:
            raise TrainingError(f"{text}: {example(kind)} is needed") from error
    Hyperparameters().by_policy(settings)
    return settings
