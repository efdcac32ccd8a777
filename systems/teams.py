"""Teams: agents that share their rewards and cannot hurt each other."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from outlast.components import Guard, Phase, SelfView, Side, Sides
from outlast.components.agent import present
from outlast.components.limits import MANY
from outlast.ecs import Entity, Field, Layout, Module, NumberError, Read, Rows, Singleton, Write, kernel, number

from .observation_rows import observe


@dataclass(frozen=True)
class Teams(Module):
    """Agents are split into `count` teams by id, as evenly as possible (paper, section 3.1 and appendix).

    Members cannot hurt each other, give only to each other, and share their rewards. sizes: the sizes of teams,
    if not an even share, as in Teams(sizes=(1, 3)): the first agents are those of the first team. In a world with fewer
    agents (Scenario.vary), the last teams lack members.
    """

    count: int = number(2, low=1, high=MANY, about="number of teams")
    sizes: tuple[float, ...] = number(
        (), low=1, high=MANY, unit="agents", about="size of each team; (): as even as possible"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if broken := [size for size in self.sizes if size != int(size)]:
            raise NumberError(f"teams.sizes = {self.sizes}: {broken[0]} is not a number of agents; take integers")
        if self.sizes and self.count != len(self.sizes):
            raise NumberError(
                f"teams.sizes = {tuple(map(int, self.sizes))} are {len(self.sizes)} teams, but teams.count is "
                f"{self.count}: set both, as in replace(teams_count={len(self.sizes)}, teams_sizes=...)"
            )

    @classmethod
    def slot(cls) -> type:
        return Sides

    def singletons(self) -> Iterable[Singleton]:
        return [Sides(teams=1)]

    def dims(self) -> dict[str, int | str]:
        return {"sides": self.count}

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("team", order=-2),)}  # behind the id

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"team": (0, self.count - 1)}}

    def groups(self, agents: int) -> tuple[int, ...]:
        if self.sizes:
            return tuple(map(int, self.sizes))
        ends = [team * agents // self.count for team in range(self.count + 1)]
        return tuple(last - first for first, last in pairwise(ends))

    def check(self, layout: Layout) -> None:
        agents, needed = layout.dims["agents"], int(sum(self.sizes))
        if self.count > agents:
            raise NumberError(f"teams.count = {self.count} teams, but there are only {agents} agents")
        if self.sizes and needed != agents and not layout.fewer:
            raise NumberError(
                f"teams.sizes = {tuple(map(int, self.sizes))} are {needed} agents, but n_agents is {agents}: take "
                f"replace(n_agents={needed}) or other sizes"
            )


@Teams.system(Phase.DRAW)
def split(
    side: Write[Side],
    guard: Write[Guard],
    entities: Read[Entity],
    agents: Rows[Side],
    count: int,
    sizes: tuple[float, ...],
) -> None:
    """Split agents by id, evenly (the last teams larger by one if need be) or by `sizes`; immune to their own team."""
    there = present(entities, agents)
    team, end = 0, np.float32(0)
    for i in range(there):
        e = agents[i]
        while team < len(sizes) and i >= end:
            end += sizes[team]
            team += 1
        side.side[e] = np.int32(team - 1 if len(sizes) > 0 else ((i + 1) * count - 1) // there)
        guard.immune_to[e] = side.side[e]


@kernel
def team_of(i: int, e: int, side: Read[Side]) -> int:
    """Return the team of an agent, dead or alive."""
    return int(side.side[e])


observe(Teams, SelfView, "own", Side, team=team_of)
