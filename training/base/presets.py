"""Presets: the paper's networks and numbers according to its text or its authors' code, and faster ones."""

from dataclasses import dataclass, replace
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.rollout.saved import forms
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.scenarios.scenario import Scenario

from .errors import TrainingError
from .hyperparameters import Hyperparameters

WORLDS, ROLLOUT = 64, 16384  # worlds that share a rollout; its environment steps, which in the paper one world plays
DEAD = ("keep", "drop")  # what becomes of the samples of dead agents, see Lane


PAPER_NUMBERS = Hyperparameters()
FAST = Hyperparameters(
    learning_rate=2e-3,
    anneal_lr=True,
    batch_size=4096,
    n_epochs=2,
    ent_coef=5e-3,  # without it some runs stop exploring before they have found what heals are for
    target_kl=0.0,
    scale_rewards=True,
)


@dataclass(frozen=True)
class Preset:
    """Networks, numbers of PPO, and the size of a rollout.

    Attributes:
        name: The name by which it is chosen.
        activation: "tanh" or "relu".
        shared: Whether policy and value have one extractor, or one each.
        leaky: Whether hidden entities are attended to, with their logits raised by 1, averages are over the number of
            all rows, and an entity of zeros is always visible, as in the authors' code. Otherwise hidden ones are left
            out of both.
        scaled: Whether inputs are brought to about -1 to 1.
        egocentric: Whether agents observe everything from where they stand and look, see `egocentric`.
        cameras: The value of cameras_mode, that is what the rows of hidden entities hold.
        masked: Whether actions that can change nothing, as a strike with a weapon that is cooling down, are not drawn:
            then they are `noop`, and there is nothing to learn from them.
        width: Width of every embedding.
        heads: Heads of the attention.
        hidden: Width of both layers behind the extractor.
        numbers: The numbers of PPO, unless others are asked for.
        agents: Agents of all worlds together, unless the number of worlds is given; 0: there are WORLDS worlds.
        steps: Steps of each world in a rollout; 0: all worlds share ROLLOUT steps.
    """

    name: str
    activation: str
    shared: bool
    leaky: bool
    scaled: bool = False
    egocentric: bool = False
    cameras: str = "masked"
    masked: bool = False
    width: int = 32
    heads: int = 4
    hidden: int = 64
    numbers: Hyperparameters = PAPER_NUMBERS
    agents: int = 0
    steps: int = 0

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the observations of this preset. Without cameras, it stays as it is."""
        if "cameras" not in scenario:
            return scenario
        return scenario.replace(cameras_mode=self.cameras).titled_as(scenario)

    def difference(self, recorded: Any, scenario: Scenario) -> str:
        """Return how a recorded scenario differs from what this preset makes of `scenario`; "": not at all.

        recorded: The fingerprint of the recorded scenario. scenario: As it is asked for, without the observations that
        the preset or opponents need.
        """
        found = [difference(recorded, fingerprint(form)) for form in forms(self.scenario(scenario))]
        return found[0] if all(found) else ""

    def size(self, agents: int, worlds: int = 0, rollout: int = 0) -> tuple[int, int]:
        """Return how many worlds of so many agents, and environment steps of all of them, a rollout has.

        worlds, rollout: What is asked for; 0: as the preset has it. Raises TrainingError if the worlds cannot share the
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
        Preset("original", activation="tanh", shared=True, leaky=True, cameras="revealed"),
        PAPER,
        SCALED,
        replace(SCALED, name="fast", egocentric=True, shared=True, masked=True, agents=512, steps=128, numbers=FAST),
    )
}


def preset(name: Any) -> Preset:
    """Return the preset of that name. For any other, raises a ScenarioError that lists all presets."""
    if name not in PRESETS:
        raise ScenarioError(f"there is no preset '{name}'; known: {', '.join(PRESETS)}")
    return PRESETS[name]
