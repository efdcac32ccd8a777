"""Two mechanics that add fields to observations of others: stamina to the agent's own row, age to rows of heals."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Heal, HealView, ObservationMasks, Phase, SelfView, Side
from outlast.ecs import (
    Archetype,
    Array,
    Bitset,
    Component,
    Entity,
    Field,
    Layout,
    Module,
    Offset,
    Read,
    RowIndex,
    Rows,
    Write,
    column,
    kernel,
    number,
    ref,
)
from outlast.systems.observation_rows import write_rows


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


@Stamina.system(Phase.OBSERVE)
def see_stamina(
    breath: Read[Breath], entities: Read[Entity], view: Write[SelfView], agents: Rows[Side], own_stamina: Offset
) -> None:
    for i in range(agents.size):
        view.own[i, own_stamina] = breath.left[agents[i]] if entities.alive[agents[i]] else 0


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


@kernel
def fill_age(row: Array, e: int, filled: bool, tables: tuple[Array, int]) -> None:
    age, column = tables
    row[column] = age.ticks[e] if filled else 0


@Freshness.system(Phase.OBSERVE)
def see_age(
    view: Write[HealView],
    masks: Read[ObservationMasks],
    age: Read[Age],
    heals: Bitset[Heal],
    index: RowIndex[Heal],
    heals_age: Offset,
) -> None:
    write_rows(view.heals, view.heals_mask, masks, heals, index, fill_age, (age, heals_age))
