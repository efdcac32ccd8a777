"""Presets: the paper's networks and numbers according to its text or its authors' code, and faster ones."""

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple

from outlast.ecs import NumberError, number
from outlast.ecs.declarations.numbers import checked
from outlast.ecs.kernels.errors import meant
from outlast.ecs.kernels.integers import as_whole
from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import MASKED, REVEALED, forms
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.scenarios.parse import typed
from outlast.envs.scenarios.scenario import Scenario

from .errors import TrainingError

TOGETHER = ("gamma", "gae_lambda", "scale_rewards")  # these act on rollouts, so all policies of a run share them
WORLDS, ROLLOUT = 64, 16384  # worlds of a rollout, and its environment steps, which one world plays in the paper
DEAD = ("keep", "drop")  # an agent's samples go on until its episode ends, or they end with its death


class ChoicesBySide(tuple[str, ...]):
    """Choices that can differ by side: a text such as "fast,seeker:paper" is also in them."""

    def __contains__(self, text: object) -> bool:
        with contextlib.suppress(ValueError):
            return all(super(ChoicesBySide, self).__contains__(each) for each in by_side(str(text)).values())
        return False


def by_side(text: str) -> dict[str, str]:
    """Return the choices in a text such as "fast,seeker:paper": by side, and that of all others under "", first.

    Raises ValueError: none is for all others, or a side has two.
    """
    found = {"": ""}
    for part in text.split(","):
        side, _, choice = part.rpartition(":")
        if found.get(side):
            raise ValueError(f"{text}: {side or 'all others'} cannot have both {found[side]} and {choice}")
        found[side] = choice
    if not found[""]:
        raise ValueError(f"{text}: one for all other sides is needed, too, as in fast,{text}")
    return found


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

        settings: "ent_coef" for all, "seeker:ent_coef" for one. own: Those of some policies. Raises TrainingError.
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


PAPER_NUMBERS = Hyperparameters()
FAST = Hyperparameters(
    learning_rate=2e-3,
    anneal_lr=True,
    batch_size=4096,
    n_epochs=2,
    ent_coef=5e-3,  # without it some runs stop exploring before they learn to use heals
    target_kl=0.0,
    scale_rewards=True,
)


class Form(NamedTuple):
    """The form in which networks take observations, see Preset."""

    leaky: bool
    egocentric: bool


@dataclass(frozen=True)
class Preset:
    """Networks, numbers of PPO, and the size of a rollout.

    Attributes:
        name: The name by which it is chosen, with those of sides that have others: "fast,seeker:paper".
        activation: "tanh" or "relu".
        shared: Whether policy and value share one extractor.
        leaky: Whether hidden entities are attended to, with their logits raised by 1, averages are over the number of
            all rows, and an entity of zeros is always visible, as in the authors' code. Otherwise hidden ones are left
            out of both.
        scaled: Whether inputs are brought to about -1 to 1.
        egocentric: Whether agents observe everything from where they stand and look, see `egocentric`.
        cameras: The value of cameras_mode, that is what the rows of hidden entities hold. If sides differ, "revealed".
        masked: Whether actions that can change nothing, as a strike with a weapon that is cooling down, are not drawn:
            then they are `noop`, and there is nothing to learn from them.
        width: Width of every embedding.
        heads: Heads of the attention.
        hidden: Width of both layers behind the extractor.
        numbers: Default numbers of PPO.
        agents: Agents of all worlds together, unless the number of worlds is given; 0: there are WORLDS worlds.
        steps: Steps of each world in a rollout; 0: all worlds share ROLLOUT steps.
        sides: If sides have different ones, their presets by side, and that of all others under "". They decide all but
            the size of a rollout and the numbers that are the same for all.
    """

    name: str
    activation: str
    shared: bool
    leaky: bool
    scaled: bool = False
    egocentric: bool = False
    cameras: str = MASKED
    masked: bool = False
    width: int = 32
    heads: int = 4
    hidden: int = 64
    numbers: Hyperparameters = PAPER_NUMBERS
    agents: int = 0
    steps: int = 0
    sides: Mapping[str, "Preset"] = field(default_factory=dict)

    @property
    def form(self) -> Form:
        """The form in which its networks take observations."""
        return Form(self.leaky, self.egocentric)

    def numbers_by_policy(self, settings: Mapping[str, Any]) -> dict[str, Hyperparameters]:
        """Return the numbers of PPO with other settings, as Hyperparameters.by_policy does, from those of each side."""
        return self.numbers.by_policy(settings, {name: own.numbers for name, own in self.sides.items()})

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the observations of this preset; unchanged if it has no cameras."""
        if "cameras" not in scenario:
            return scenario
        return scenario.replace(cameras_mode=self.cameras).titled_as(scenario)

    def difference(self, recorded: Any, scenario: Scenario) -> str:
        """Return the difference between a recorded fingerprint and this preset's version of a scenario; "": none."""
        found = [difference(recorded, fingerprint(form)) for form in forms(self.scenario(scenario))]
        return found[0] if all(found) else ""

    def size(self, agents: int, worlds: int = 0, rollout: int = 0) -> tuple[int, int]:
        """Return the numbers of worlds and of their steps in a rollout; 0: as in the preset. Raises TrainingError."""
        worlds = worlds or (max(1, self.agents // agents) if self.agents else WORLDS)
        rollout = rollout or (worlds * self.steps if self.steps else ROLLOUT)
        if rollout % worlds:
            fitting = worlds * max(1, round(rollout / worlds))
            raise TrainingError(
                f"a rollout of {rollout} steps cannot be shared evenly by {worlds} worlds: take a multiple of "
                f"{worlds}, such as --rollout {fitting}"
            )
        return worlds, rollout


PAPER = Preset("paper", activation="relu", shared=False, leaky=False)
SCALED = replace(PAPER, name="scaled", scaled=True)
PRESETS = {
    preset.name: preset
    for preset in (
        Preset("original", activation="tanh", shared=True, leaky=True, cameras=REVEALED),
        PAPER,
        SCALED,
        replace(SCALED, name="fast", egocentric=True, shared=True, masked=True, agents=512, steps=128, numbers=FAST),
    )
}


def preset(name: Any) -> Preset:
    """Return the preset "fast" or "fast,seeker:paper". Raises ScenarioError, which lists all presets."""
    try:
        chosen = by_side(str(name))
    except ValueError as error:
        raise ScenarioError(f"preset {error}") from None
    for each in chosen.values():
        if each not in PRESETS:
            raise ScenarioError(f"unknown preset '{each}'; known: {', '.join(PRESETS)}")
    base = PRESETS[chosen[""]]
    if len(chosen) == 1:
        return base
    same = {number: getattr(base.numbers, number) for number in TOGETHER}
    sides = {side: replace(PRESETS[each], numbers=PRESETS[each].numbers.changed(same)) for side, each in chosen.items()}
    cameras = REVEALED if REVEALED in {each.cameras for each in sides.values()} else MASKED
    return replace(base, name=name, cameras=cameras, sides=sides)
