"""The rows of the paper's two tables: what is played in each, here and in the original implementation."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field

from outlast import Scenario, variant
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.variants import ALIASES
from outlast.errors import OutlastError
from outlast.systems import Boxes, Cameras, Heals


@dataclass(frozen=True)
class Row:
    """One row.

    Attributes:
        name: as in the paper, or the variant's.
        scenario: ours.
        paper: microseconds a step in the paper's table, measured on its laptop.
        experiment: the original's configuration; empty where the row has no cameras, which its env.step needs.
        counts: of agents, heals and boxes, where they are not those of that configuration.
    """

    name: str
    scenario: Scenario
    paper: float
    experiment: str = ""
    counts: Mapping[str, int] = field(default_factory=dict)


def _crowd(paper: float, agents: int, heals: int = 0, boxes: int = 0, cameras: bool = True) -> Row:
    """A row of the first table: the variants' configuration, free for all, with only the counts changed."""
    parts = [f"{agents} agents", "(no cameras)"] if not cameras else [f"{agents} agents"]
    items = [f"{count} {what}" for count, what in ((heals, "heals"), (boxes, "boxes")) if count]
    scenario = variant("ffa_3").replace(n_agents=agents)
    scenario = scenario.replace(n_heals=heals) if heals else scenario.without(Heals)
    scenario = scenario.replace(n_boxes=boxes) if boxes else scenario.without(Boxes)
    name = ", ".join([" ".join(parts), *items])
    if not cameras:
        return Row(name, scenario.without(Cameras), paper)
    return Row(name, scenario, paper, "1v1_all_mid", {"agents": agents, "heals": heals, "boxes": boxes})


PAPER = {  # the second table
    "1v1_heals_low": 759,
    "1v1_heals_mid": 758,
    "1v1_all_mid": 986,
    "1v1_all_high": 1040,
    "2v2_all_low": 1470,
    "2v2_heals_mid": 1210,
    "2v2_all_mid": 1400,
    "2v2_all_high": 1420,
}
ROWS = (
    _crowd(477, 5, cameras=False),
    _crowd(494, 5, 10, cameras=False),
    _crowd(507, 5, 10, 10, cameras=False),
    _crowd(572, 5),
    _crowd(724, 5, 10, 10),
    _crowd(1640, 10, 10, 20),
    _crowd(803, 10, 10, 20, cameras=False),
    *(Row(ALIASES[name], variant(name), micros, name) for name, micros in PAPER.items()),
)


def scenario(name: str) -> Scenario:
    """The scenario of a row, or what is named as commands take it: a variant, FILE.py:NAME."""
    for row in ROWS:
        if row.name == name:
            return row.scenario
    return resolve(name)


def playable(name: str) -> Scenario:
    """`scenario`, for command lines."""
    try:
        return scenario(name)
    except OutlastError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
