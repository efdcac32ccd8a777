"""The networks to choose from: the paper's as in its text, as in its authors' code, and one with scaled inputs."""

from dataclasses import dataclass, replace
from typing import Any

from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.scenario import Scenario

DEAD = ("keep", "drop")  # what becomes of the samples of dead agents, see Collector


@dataclass(frozen=True)
class Preset:
    """Numbers and choices of a network.

    shared: policy and value have one extractor; otherwise one each. padded: an entity of zeros that is always visible.
    leaky: a hidden entity is attended to, with its logit raised by 1, and rows are averaged over their full number, as
    in the authors' code. Otherwise hidden ones are left out of both. scaled: inputs are brought to about -1 to 1.
    cameras: the value of cameras_mode, that is what the rows of hidden entities hold.
    """

    name: str
    activation: str  # "tanh" or "relu"
    shared: bool
    padded: bool
    leaky: bool
    scaled: bool = False
    cameras: str = "masked"
    width: int = 32  # of every embedding
    heads: int = 4
    hidden: int = 64  # of both layers behind the extractor

    def scenario(self, scenario: Scenario) -> Scenario:
        """The scenario with the observations of this preset. A scenario without cameras stays as it is."""
        return scenario.replace(cameras_mode=self.cameras) if "cameras" in scenario else scenario


PAPER = Preset("paper", activation="relu", shared=False, padded=False, leaky=False)
PRESETS = {
    preset.name: preset
    for preset in (
        Preset("original", activation="tanh", shared=True, padded=True, leaky=True, cameras="revealed"),
        PAPER,
        replace(PAPER, name="scaled", scaled=True),
    )
}


def preset(name: Any) -> Preset:
    """The preset of that name; ScenarioError that lists all for any other."""
    if name not in PRESETS:
        raise ScenarioError(f"there is no preset '{name}'; known: {', '.join(PRESETS)}")
    return PRESETS[name]
