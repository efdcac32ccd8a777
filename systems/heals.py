"""Heals: items that give their user hit points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Body, Heal, HealsUsed, Health, HealView, Item, Phase, Shape, Side, Spawned, Told
from outlast.components.health import LARGEST, MOST
from outlast.components.inventory import last
from outlast.components.sight import told
from outlast.ecs import (
    Add,
    Archetype,
    Bitset,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    number,
)

from .inner.places import laid
from .inner.sweep import row, span


@dataclass(frozen=True)
class Heals(Module):
    """Heals lie around from the start and do not come back (paper, section 3.2)."""

    count: int = number(15, low=1)
    radius: float = number(0.25, low=0.002)  # metres
    amount: int = number(75, low=0, high=MOST)  # hit points

    def archetypes(self) -> Iterable[Archetype]:
        parts = (Body(), Shape(radius=self.radius), Spawned(), Item(), Heal(amount=self.amount))
        return [Archetype("heal", parts, self.count)]

    def singletons(self) -> Iterable[Singleton]:
        return [HealView(), HealsUsed()]

    def dims(self) -> dict[str, int | str]:
        return {"heals": self.count}

    def check(self, layout: Layout) -> None:
        layout.check_count(Heal, "heals")
        birth = layout.prefab_values(Health, "points").get("agent", 0)
        if self.count * self.amount + birth > LARGEST:
            raise NumberError(
                f"heals.count = {self.count} times heals.amount = {self.amount} is more than the {LARGEST} hit points "
                "that an agent can have; take fewer, or smaller ones"
            )

    def bounds(self, layout: Layout) -> Mapping[str, tuple[Any, Any]]:
        far, amounts = laid(layout), layout.prefab_values(Heal, "amount").values()
        return {"heals": (-far, far), "heal_slot": (0, max(map(np.max, amounts)))}


@Heals.system(Phase.EFFECT)
def cure(health: Add[Health], used: Add[HealsUsed], item: Read[Item], heal: Read[Heal], heals: Rows[Heal]) -> None:
    """The user gains hit points."""
    for thing in heals:
        if item.user[thing] >= 0:
            health.points[item.user[thing]] += heal.amount[thing]
            used.heals_used[0] += 1


@Heals.system(Phase.OBSERVE)
def see_heals(
    view: Write[HealView],
    tell: Read[Told],
    body: Read[Body],
    agents: Rows[Side],
    heals: Bitset[Heal],
    index: RowIndex[Heal],
) -> None:
    """Position of each heal on the ground."""
    first, last = span(heals)
    for i in range(agents.size):
        for g in range(first, last):
            left = tell.stale[i, g] & heals[g]
            while left:
                e = row(g, left)
                left &= left - 1
                k, filled = index[e], told(tell.filled, i, e)
                view.heals_mask[i, k] = told(tell.masks, i, e)
                view.heals[i, k, 0] = body.x[e] if filled else 0
                view.heals[i, k, 1] = body.y[e] if filled else 0


@Heals.system(Phase.OBSERVE, after="heals.see_heals")
def see_slot(
    view: Write[HealView],
    bag: Read[Bag],
    heal: Read[Heal],
    entities: Read[Entity],
    agents: Rows[Bag],
    index: RowIndex[Heal],
) -> None:
    """The last slot of the bag, if it holds a heal."""
    for i in range(agents.size):
        e = agents[i]
        thing = last(bag, e)
        held = entities.alive[e] != 0 and thing >= 0 and index[thing] >= 0
        view.heal_slot[i, 0, 0] = heal.amount[thing] if held else 0
        view.heal_slot_mask[i, 0] = 1 if held else 0
