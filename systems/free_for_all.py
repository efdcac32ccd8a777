"""Free for all: every agent is a side of its own."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Phase, Side, Sides
from outlast.components.agent import present
from outlast.ecs import Entity, Module, Read, Rows, Singleton, Write


@dataclass(frozen=True)
class FreeForAll(Module):
    """Every agent is a side of its own."""

    @classmethod
    def slot(cls) -> type:
        return Sides

    def singletons(self) -> Iterable[Singleton]:
        return [Sides(teams=0)]

    def dims(self) -> dict[str, int | str]:
        return {"sides": "agents"}


@FreeForAll.system(Phase.DRAW)
def split(side: Write[Side], entities: Read[Entity], agents: Rows[Side]) -> None:
    """Make agent i side i."""
    for i in range(present(entities, agents)):
        side.side[agents[i]] = np.int32(i)
