"""Two mechanics that add fields to observations of others: stamina to the agent's own row, age to rows of heals."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Heal, HealView, Phase, SelfView, Side
from outlast.ecs import Archetype, Array, Component, Field, Layout, Module, Rows, Write, column, number, ref
from outlast.systems.observation_rows import observe


class Breath(Component):
    left: Array = column("i4", fill=100)


class Age(Component):
    ticks: Array = column("i4")


@dataclass(frozen=True)
class Stamina(Module):
    """Agents lose breath with every tick, and observe it."""

    most: int = number(100, low=1)

    def archetypes(self) -> Any:
        return [Archetype("agent", (Breath(left=ref("most")),))]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("stamina", "ticks", scale=lambda layout: layout.numbers("stamina")["most"]),)}

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"stamina": (0, self.most)}}


@Stamina.system(Phase.DRIVE)
def tire(breath: Write[Breath], agents: Rows[Breath]) -> None:
    for i in range(agents.size):
        breath.left[agents[i]] = max(0, breath.left[agents[i]] - 1 - i)


observe(Stamina, SelfView, "own", Side, stamina=Breath.left)


class Freshness(Module):
    """Heals age. Their rows begin with the age, before the place."""

    def archetypes(self) -> Any:
        return [Archetype("heal", (Age(),))]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"heals": (Field("age", "ticks", scale=50.0, low=0, order=-1),)}


@Freshness.system(Phase.DRIVE)
def grow_old(age: Write[Age], heals: Rows[Age]) -> None:
    for k in range(heals.size):
        age.ticks[heals[k]] += 1 + k


observe(Freshness, HealView, "heals", Heal, age=Age.ticks)
