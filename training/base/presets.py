"""Presets: the paper's networks and numbers according to its text or its authors' code, and faster ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from outlast.envs.core.options import by_side
from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import MASKED, REVEALED, forms
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.scenarios.scenario import Scenario

from .errors import TrainingError
from .hyperparameters import TOGETHER, Hyperparameters

WORLDS, ROLLOUT = 64, 16384  # worlds of a rollout, and its environment steps, which one world plays in the paper
DEAD = ("keep", "drop")  # an agent's samples go on until its episode ends, or they end with its death


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
        """Return the difference between a recorded scenario and this preset's version of `scenario`; "": none.

        recorded: The fingerprint of the recorded scenario. scenario: The requested one, without the observations that
        the preset or opponents need.
        """
        found = [difference(recorded, fingerprint(form)) for form in forms(self.scenario(scenario))]
        return found[0] if all(found) else ""

    def size(self, agents: int, worlds: int = 0, rollout: int = 0) -> tuple[int, int]:
        """Return the number of worlds with this many agents, and the environment steps of a rollout of all of them.

        worlds, rollout: Requested values; 0: those of the preset. Raises TrainingError if the worlds cannot share the
        steps evenly.
        """
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
    """Return the preset of that name, such as "fast", or "fast,seeker:paper" with another one for a side.

    Raises ScenarioError, which lists all presets, for any other name.
    """
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
