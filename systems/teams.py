"""Teams: agents that share their rewards and cannot hurt each other."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Guard, Phase, Side, Sides
from outlast.ecs import Layout, Module, NumberError, Rows, Singleton, Write, number


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
        return {"sides": self.count, "features": 1}

    def check(self, layout: Layout) -> None:
        if self.count > layout.dims["agents"]:
            raise NumberError(f"teams.count = {self.count} teams, but there are only {layout.dims['agents']} agents")


@Teams.system(Phase.DRAW)
def split(side: Write[Side], guard: Write[Guard], agents: Rows[Side], count: int) -> None:
    """Consecutive ids, teams of equal size (the last ones larger by one if need be); immune to one's own."""
    for i in range(agents.size):
        e = agents[i]
        side.side[e] = np.int32(((i + 1) * count - 1) // agents.size)
        guard.immune_to[e] = side.side[e]
