"""Ways to mend the four flaws that the paper finds in its own game (section 5), each by a name."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from outlast.ecs import Module
from outlast.systems import Ending, Heals, Melee, Motors, Steering, Teams

from .scenario import Scenario, ScenarioError


@dataclass(frozen=True)
class Fix:
    """What to change in a scenario. flaw: its number in the paper. needs: without that mechanic, nothing changes."""

    flaw: int
    about: str
    needs: type[Module]
    numbers: dict[str, Any] = field(default_factory=dict)
    modules: tuple[Module, ...] = ()


_ENDS = {"rewards_alive": 0.0, "rewards_dead": 0.0, "ending_rule": "last alive"}
_KILLS = {"rewards_kill": 100.0, "rewards_death": -100.0, "rewards_outlive": 0.0}
_OUTLIVES = {"rewards_kill": 0.0, "rewards_death": 0.0, "rewards_outlive": 100.0}

FIXES = {
    "health_cap": Fix(1, "health ends at 100, so a heal is worth keeping", Heals, {"health_limit": 100}),
    "team_share": Fix(2, "each dead teammate costs its share of the reward", Teams, {"rewards_basis": "members"}),
    "bounty": Fix(3, "only kills and deaths count, so fights are worth it", Melee, _ENDS | _KILLS),
    "rivalry": Fix(3, "only outliving the other side counts, however it dies", Ending, _ENDS | _OUTLIVES),
    "steering": Fix(4, "velocity is set directly, in seven levels", Motors, modules=(Steering(),)),
}


def fixed(scenario: Scenario, names: Sequence[str]) -> Scenario:
    """The scenario with flaws mended, named "teams_2+health_cap+steering" in the order of FIXES.

    Raises ScenarioError for an unknown name, for two that contradict each other, and where one would change nothing.
    """
    for name in names:
        if name not in FIXES:
            raise ScenarioError(f"there is no fix '{name}'; known: {', '.join(FIXES)}")
    chosen = {name: fix for name, fix in FIXES.items() if name in names}
    if len(chosen) < len(names):
        raise ScenarioError(f"{'+'.join(names)}: name each fix once")
    if {"bounty", "rivalry"} <= chosen.keys():
        raise ScenarioError("bounty and rivalry contradict each other: take one of them")
    for name, fix in chosen.items():
        if not any(isinstance(module, fix.needs) for module in scenario.modules):
            raise ScenarioError(f"{scenario.name} has no {fix.needs.__name__}, so {name} would change nothing")
        scenario = scenario.with_(*fix.modules).replace(**fix.numbers)
    about = "; ".join((scenario.about, *(fix.about for fix in chosen.values())))
    return replace(scenario, name="+".join((scenario.name, *chosen)), about=about)
