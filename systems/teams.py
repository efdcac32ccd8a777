"""Teams: agents that share their rewards and cannot hurt each other."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Guard, Phase, SelfView, Side, Sides
from outlast.components.agent import present
from outlast.ecs import Entity, Field, Layout, Module, NumberError, Offset, Read, Rows, Singleton, Write, number


@dataclass(frozen=True)
class Teams(Module):
    """Agents are split into `count` teams by id, as evenly as possible (paper, section 3.1 and appendix).

    Members cannot hurt each other, give only to each other, and share their rewards.
    """

    count: int = number(2, low=1)

    @classmethod
    def slot(cls) -> type:
        return Sides

    def singletons(self) -> Iterable[Singleton]:
        return [Sides(teams=1)]

    def dims(self) -> dict[str, int | str]:
        return {"sides": self.count}

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("team", order=-1),)}  # behind the id

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"team": (0, self.count - 1)}}

    def check(self, layout: Layout) -> None:
        if self.count > layout.dims["agents"]:
            raise NumberError(f"teams.count = {self.count} teams, but there are only {layout.dims['agents']} agents")


@Teams.system(Phase.DRAW)
def split(side: Write[Side], guard: Write[Guard], entities: Read[Entity], agents: Rows[Side], count: int) -> None:
    """Consecutive ids, teams of equal size (the last ones larger by one if need be); immune to one's own."""
    there = present(entities, agents)
    for i in range(there):
        e = agents[i]
        side.side[e] = np.int32(((i + 1) * count - 1) // there)
        guard.immune_to[e] = side.side[e]


@Teams.system(Phase.OBSERVE)
def see_team(side: Read[Side], view: Write[SelfView], agents: Rows[Side], own_team: Offset) -> None:
    """The team of each agent, dead or alive."""
    for i in range(agents.size):
        view.own[i, own_team] = side.side[agents[i]]
