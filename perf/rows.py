"""The rows of the paper's two tables, and what the paper and the original implementation took for each.

Microseconds a step. `paper`: the paper's tables, on its laptop. `simulation` and `step`: the original implementation,
its simulation object's step alone and its whole env.step with observations and rewards, run unmodified on one core of a
2.5 GHz Xeon (reference timings; minimum of three runs of 3000 steps). None: not measured.
"""

from dataclasses import dataclass

from outlast import Scenario, variant
from outlast.systems import Boxes, Cameras, Heals


@dataclass(frozen=True)
class Row:
    """One row: its scenario and the others' microseconds a step."""

    name: str
    scenario: Scenario
    paper: float
    simulation: float | None
    step: float | None

    @property
    def original(self) -> float:
        """What ours is compared with: env.step where it was measured, else the simulation's step alone."""
        return self.step if self.step is not None else self.simulation or float("nan")

    @property
    def simulation_only(self) -> bool:
        """Whether the row stands for the simulation without observations: then ours is timed without them, too."""
        return self.step is None


def _features(agents: int, heals: int = 0, boxes: int = 0, cameras: bool = True) -> Scenario:
    """A row of the first table: the variants' configuration, free for all, with only the counts changed."""
    scenario = variant("ffa_3").replace(n_agents=agents)
    scenario = scenario.replace(n_heals=heals) if heals else scenario.without(Heals)
    scenario = scenario.replace(n_boxes=boxes) if boxes else scenario.without(Boxes)
    return scenario if cameras else scenario.without(Cameras)


ROWS = (
    Row("5 agents (no cameras)", _features(5, cameras=False), 477, 424, None),
    Row("5 agents (no cameras), 10 heals", _features(5, 10, cameras=False), 494, 443, None),
    Row("5 agents (no cameras), 10 heals, 10 boxes", _features(5, 10, 10, cameras=False), 507, 456, None),
    Row("5 agents", _features(5), 572, 598, 1019),
    Row("5 agents, 10 heals, 10 boxes", _features(5, 10, 10), 724, 831, 1721),
    Row("10 agents, 10 heals, 20 boxes", _features(10, 10, 20), 1640, 1711, 3403),
    Row("10 agents (no cameras), 10 heals, 20 boxes", _features(10, 10, 20, cameras=False), 803, 791, None),
    Row("ffa_1", variant("ffa_1"), 759, None, 800),
    Row("ffa_2", variant("ffa_2"), 758, None, 694),
    Row("ffa_3", variant("ffa_3"), 986, None, 1077),
    Row("ffa_4", variant("ffa_4"), 1040, None, 1049),
    Row("teams_1", variant("teams_1"), 1470, None, 1588),
    Row("teams_2", variant("teams_2"), 1210, None, 1186),
    Row("teams_3", variant("teams_3"), 1400, None, 1471),
    Row("teams_4", variant("teams_4"), 1420, None, 1502),
)


def scenario(name: str) -> Scenario:
    """The scenario of a row, or the variant of that name."""
    for row in ROWS:
        if row.name == name:
            return row.scenario
    return variant(name)
