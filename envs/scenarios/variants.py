"""The paper's eight variants, as data (reference rules, section 0), and ablations of the flaws that it finds.

Where the paper's text differs from the runs behind its figures, the default of a mechanic follows the text, and BASE
below has the values of the runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from outlast.ecs import Module
from outlast.ecs.kernels.errors import did_you_mean
from outlast.systems import (
    Agents,
    Boxes,
    Cameras,
    DeathDrop,
    Ending,
    FreeForAll,
    GiveLast,
    Heals,
    Inventory,
    Melee,
    Mortality,
    Motors,
    Physics,
    Pickup,
    Record,
    Rewards,
    Room,
    SafeZone,
    SpawnGrid,
    Steering,
    Teams,
)

from ..errors import ScenarioError
from .scenario import Number, Scenario


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


BASE = Scenario(
    "base",
    (
        Agents(count=2, radius=0.5, health=100),
        Room(size=25.0),
        SpawnGrid(cells=8),
        Motors(ahead=0.25, left=0.25, turn=0.0125, give="at once"),
        Physics(),
        Cameras(fov=0.4 * 3.141592653589793, depth=10.0, cone="kite"),
        Mortality(),
        Melee(reach=2.0, damage=5, cooldown=0, blocked=True),
        Inventory(slots=4),
        Pickup(reach=0.5, touch=False),
        GiveLast(reach=2.0, nearest="any", passes_on=True),
        DeathDrop(radius=0.5, scatter="rim"),
        Heals(count=15, amount=75),
        SafeZone(radii=(12.5, 10.0, 7.5, 5.0, 4.0, 2.0, 1.0), stand=100, shrink=100, damage=1),
        FreeForAll(),
        Rewards(posthumous=False),
        Ending(),
        Record(),
    ),
)
BOXES = Boxes(count=8, toughness=5, owned=True, offset=0.75, settles=True, corners="rolled")
TEAMS = BASE.with_(Teams(count=2)).replace(n_agents=4, rewards_posthumous=True)

LOW: dict[str, Number] = {"rewards_alive": 1.0, "ending_rule": "all dead"}
MID: dict[str, Number] = {"rewards_alive": 1.0, "rewards_dead": -1.0, "ending_rule": "last alive"}
HIGH: dict[str, Number] = {**MID, "rewards_kill": 100.0, "rewards_death": -100.0}

_ROWS = (
    ("ffa_1", "1v1_heals_low", BASE, LOW, "two agents, heals; survival pays"),
    ("ffa_2", "1v1_heals_mid", BASE, MID, "two agents, heals; outliving pays"),
    ("ffa_3", "1v1_all_mid", BASE.with_(BOXES), MID, "two agents, heals and boxes; outliving pays"),
    ("ffa_4", "1v1_all_high", BASE.with_(BOXES), HIGH, "two agents, heals and boxes; killing pays"),
    ("teams_1", "2v2_all_low", TEAMS.with_(BOXES), LOW, "two teams of two, heals and boxes; survival pays"),
    ("teams_2", "2v2_heals_mid", TEAMS, MID, "two teams of two, heals; outliving pays"),
    ("teams_3", "2v2_all_mid", TEAMS.with_(BOXES), MID, "two teams of two, heals and boxes; outliving pays"),
    ("teams_4", "2v2_all_high", TEAMS.with_(BOXES), HIGH, "two teams of two, heals and boxes; killing pays"),
)

VARIANTS = {name: Scenario(name, base.replace(**numbers).modules, about) for name, _, base, numbers, about in _ROWS}
ALIASES = {original: name for name, original, *_ in _ROWS}


def base(name: str) -> str:
    """Return the name of a variant without its ablations."""
    return name.partition("+")[0]


def variant(name: str) -> Scenario:
    """Return one of the paper's variants, with ablations if the name has any.

    Args:
        name: Our name or the paper's, "teams_2" or "2v2_heals_mid". Ablations (see ABLATIONS) follow it, each after a
            plus: "teams_2+health_cap".

    Raises:
        ScenarioError: The variant (the message lists all of them) or the ablation is unknown.
    """
    plain, *ablations = str(name).split("+")
    found = VARIANTS.get(ALIASES.get(plain, plain))
    if found is None:
        hint = did_you_mean(plain, [*VARIANTS, *ALIASES], after=" ")
        known = ", ".join(f"{name} ({alias})" for alias, name in ALIASES.items())
        raise ScenarioError(f"there is no variant '{plain}'; {hint}known: {known}")
    return ablated(found, ablations) if ablations else found


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
