"""PPO's hyperparameters: those of the authors' runs, and their ranges."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

from outlast.ecs import NumberError, number
from outlast.ecs.declarations.numbers import checked
from outlast.ecs.kernels.errors import meant
from outlast.ecs.kernels.integers import as_whole
from outlast.envs.scenarios.parse import typed

from .errors import TrainingError

TOGETHER = ("gamma", "gae_lambda", "scale_rewards")  # these act on rollouts, so all policies of a run share them


@dataclass(frozen=True)
class Hyperparameters:
    """The numbers of PPO, declared as those of mechanics are; the defaults are those of the authors' runs."""

    learning_rate: float = number(3e-4, above=0, about="learning rate of Adam")
    anneal_lr: bool = number(
        False, about="whether the learning rate falls to 0 along the run, in proportion to the steps that are left"
    )
    batch_size: int = number(  # of at least 2, as advantages are normalised in each minibatch
        512, low=2, about="approximate samples of a minibatch; the samples of a rollout are divided evenly"
    )
    n_epochs: int = number(
        400, low=1, about="maximum passes over the samples; the divergence ends most updates earlier"
    )
    gamma: float = number(0.99, low=0, high=1, about="discount of a step")
    gae_lambda: float = number(0.95, low=0, high=1, about="how far advantages look ahead, from 0 to 1")
    clip_range: float = number(
        0.2, above=0, about="how far the ratio of probabilities may move away from 1 before it is clipped"
    )
    ent_coef: float = number(0.0, low=0, about="weight of the entropy in the loss")
    vf_coef: float = number(0.5, low=0, about="weight of the values in the loss")
    max_grad_norm: float = number(0.5, above=0, about="norm that gradients are clipped to")
    target_kl: float = number(
        0.01, low=0, about="the update ends before a minibatch whose divergence is above 1.5 times this; 0: never"
    )
    scale_rewards: bool = number(
        False,
        about="whether rewards are divided by the running standard deviation of their discounted sums, that of all "
        "agents, trained or not, including absent ones",
    )

    def __post_init__(self) -> None:
        """Raise TrainingError if a number has the wrong type, or is out of its range."""
        for item in fields(self):
            kind, value = KINDS[item.name], getattr(self, item.name)
            value = as_whole(value) if kind is int else value
            try:
                object.__setattr__(self, item.name, checked(item.name, value, kind, item.metadata))
            except NumberError as error:
                raise TrainingError(str(error)) from None

    def by_policy(
        self, settings: Mapping[str, Any], own: Mapping[str, "Hyperparameters"] = MappingProxyType({})
    ) -> dict[str, "Hyperparameters"]:
        """Return copies with other settings by the name of the policy, "" for those that are not named.

        settings: "ent_coef" for all policies, "seeker:ent_coef" for one of them. own: The numbers of policies to which
        settings are applied instead of these. Raises TrainingError as `changed`.
        """
        given = dict[str, dict[str, Any]]({name: {} for name in ("", *own)})
        for name, value in settings.items():
            policy, _, its = name.rpartition(":")
            if policy and its in TOGETHER:
                shared = ", ".join(TOGETHER)
                raise TrainingError(f"{name}: all policies share {shared}; set {its} without a policy")
            given.setdefault(policy, {})[its] = value
        return {name: own.get(name, self).changed(given[""] | changes) for name, changes in given.items()}

    def changed(self, settings: Mapping[str, Any]) -> "Hyperparameters":
        """Return a copy with some settings changed. Raises TrainingError for unknown names and impossible values."""
        for name in settings:
            if name not in KINDS:
                raise TrainingError(f"PPO has no hyperparameter '{name}'; {meant(name, KINDS)}")
        return replace(self, **settings)


KINDS: dict[str, type] = {each.name: type(each.default) for each in fields(Hyperparameters)}


def parse_hyperparameters(texts: Iterable[str]) -> dict[str, Any]:
    """Parse hyperparameters from texts like "gamma=0.999" and "seeker:ent_coef=0.01". Raises TrainingError."""
    settings: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in settings:
            raise TrainingError(f"{text}: {name} is given twice; remove one of them")
        its = name.rpartition(":")[2]
        settings[name] = typed(value, getattr(Hyperparameters, its)) if its in KINDS else value
    Hyperparameters().by_policy(settings)
    return settings
