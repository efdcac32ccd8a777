"""Heals: items that give their user hit points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Heal, HealsUsed, Health, HealView, Item, Phase, Shape, Spawned
from outlast.components.health import LARGEST, MOST
from outlast.components.limits import FAR, MANY
from outlast.ecs import Add, Archetype, Layout, Module, NumberError, Read, Rows, Singleton, number, ref

from .geometry.bounds import check_fits, ends, farthest_item
from .observation_rows import observe


@dataclass(frozen=True)
class Heals(Module):
    """Heals lie on the floor from the start, and are not replaced (paper, section 3.2)."""

    count: int = number(15, low=0, high=MANY, about="number of heals")
    radius: float = number(0.25, low=0.002, high=FAR, unit="metres", about="radius of a heal")
    amount: int = number(75, low=0, high=MOST, unit="hit points", about="what an agent gets by using a heal")

    def archetypes(self) -> Iterable[Archetype]:
        parts = (Body(), Shape(radius=ref("radius")), Spawned(), Item(), Heal(amount=ref("amount")))
        return [Archetype("heal", parts, ref("count"), order=40)]

    def singletons(self) -> Iterable[Singleton]:
        return [HealView(), HealsUsed()]

    def dims(self) -> dict[str, int | str]:
        return {"heals": ref("count")}

    def check(self, layout: Layout) -> None:
        layout.check_count(Heal, "heals")
        check_fits(layout, "heals.radius", self.radius, 2 * self.radius)
        prefab = layout.prefab_values(Health, "points").get("agent", 0)
        if self.count * self.amount + prefab > LARGEST:
            raise NumberError(
                f"heals.count = {self.count} times heals.amount = {self.amount} is more than the {LARGEST} hit points "
                "that an agent can have; take fewer, or smaller ones"
            )

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        place, amounts = ends(farthest_item(layout)), layout.prefab_values(Heal, "amount").values()
        return {"heals": place, "heal_slot": {"amount": (0, max(map(np.max, amounts)))}}


@Heals.system(Phase.EFFECT)
def heal(health: Add[Health], used: Add[HealsUsed], item: Read[Item], heal: Read[Heal], heals: Rows[Heal]) -> None:
    """Give hit points to the user."""
    for row in heals:
        if item.user[row] >= 0:
            health.points[item.user[row]] += heal.amount[row]
            used.heals_used[0] += 1


observe(Heals, HealView, "heals", Heal, x=Body.x, y=Body.y)
observe(Heals, HealView, "heal_slot", Heal, amount=Heal.amount)
