"""Changes to a scenario, each of which removes one of the four flaws that the paper finds in its game (section 5)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from outlast.ecs import Module
from outlast.systems import Ending, Heals, Melee, Motors, Steering, Teams

from ..errors import ScenarioError
from .scenario import Scenario


@dataclass(frozen=True)
class Ablation:
    """Changes of a scenario.

    Attributes:
        flaw: Number of the flaw in the paper.
        about: What it changes, in words.
        needs: The mechanic without which it would change nothing.
        numbers: Numbers to change, by full name.
        modules: Mechanics to add, or to put in place of others.
    """

    flaw: int
    about: str
    needs: type[Module]
    numbers: dict[str, Any] = field(default_factory=dict)
    modules: tuple[Module, ...] = ()


_ENDS = {"rewards_alive": 0.0, "rewards_dead": 0.0, "ending_rule": "last alive"}
_KILLS = {"rewards_kill": 100.0, "rewards_death": -100.0, "rewards_outlive": 0.0}
_OUTLIVES = {"rewards_kill": 0.0, "rewards_death": 0.0, "rewards_outlive": 100.0}

ABLATIONS = {
    "health_cap": Ablation(1, "health ends at 100, so a heal is worth keeping", Heals, {"mortality_limit": 100}),
    "team_share": Ablation(2, "each dead teammate costs its share of the reward", Teams, {"rewards_basis": "members"}),
    "bounty": Ablation(3, "only kills and deaths count, so fights are worth it", Melee, _ENDS | _KILLS),
    "rivalry": Ablation(3, "only outliving the other side counts, however it dies", Ending, _ENDS | _OUTLIVES),
    "steering": Ablation(4, "velocity is set directly, in seven levels", Motors, modules=(Steering(),)),
}


def ablated(scenario: Scenario, names: Sequence[str]) -> Scenario:
    """Apply ablations to a scenario; its new name, "teams_2+health_cap+steering", has them in the order of ABLATIONS.

    Raises ScenarioError if a name is unknown, two ablations contradict each other, or one would change nothing.
    """
    for name in names:
        if name not in ABLATIONS:
            raise ScenarioError(f"there is no ablation '{name}'; known: {', '.join(ABLATIONS)}")
    chosen = {name: ablation for name, ablation in ABLATIONS.items() if name in names}
    if len(chosen) < len(names):
        raise ScenarioError(f"{'+'.join(names)}: name each ablation once")
    if {"bounty", "rivalry"} <= chosen.keys():
        raise ScenarioError("bounty and rivalry contradict each other: take one of them")
    plain = scenario
    for name, ablation in chosen.items():
        if not any(isinstance(module, ablation.needs) for module in scenario.modules):
            raise ScenarioError(f"{plain.name} has no {ablation.needs.__name__}, so {name} would change nothing")
        scenario = scenario.with_(*ablation.modules).replace(**ablation.numbers)
    about = "; ".join((plain.about, *(ablation.about for ablation in chosen.values())))
    return replace(scenario, name="+".join((plain.name, *chosen)), about=about)
