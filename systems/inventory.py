"""Inventory: a bag with a few slots, and the use of its last item."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Bag, Item, ItemUsed, Phase, Side, Use
from outlast.components.inventory import CLOSED, empty, pop
from outlast.components.limits import MANY
from outlast.components.masks import of_agents
from outlast.components.respawn import inactive
from outlast.ecs import (
    Archetype,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    Rows,
    Singleton,
    System,
    WorldsView,
    Write,
    emit,
    number,
    of,
)


@dataclass(frozen=True)
class Inventory(Module):
    """Bags of agents (paper, section 3.1): a stack of items, of which the last one can be used."""

    slots: int = number(4, low=1, high=MANY, about="items that a bag can hold")
    capacity: int = number(
        0, low=0, high=MANY, per_agent=True, about="slots that an agent can fill, at most inventory_slots; 0: all"
    )

    def systems(self) -> Iterable[System]:
        return [system for system in super().systems() if self.capacity or system.name != "close_slots"]

    def check(self, layout: Layout) -> None:
        if self.capacity > self.slots:
            raise NumberError(
                f"inventory.capacity = {self.capacity}: bags have inventory.slots = {self.slots}; set both"
            )

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Bag(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Use(), ItemUsed()]

    def dims(self) -> dict[str, int | str]:
        return {"slots": self.slots}

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        return {"use": inactive(worlds) | of_agents(empty, worlds, Bag)}


@Inventory.system(Phase.DRAW)
def close_slots(bag: Write[Bag], agents: Rows[Bag], capacity: int) -> None:
    """Close slots beyond an agent's capacity, so that they stay empty."""
    for e in agents:
        for k in range(of(capacity, e), bag.items.shape[1] if of(capacity, e) > 0 else 0):
            bag.items[e, k] = CLOSED


@Inventory.system(Phase.USE)
def use_last(
    bag: Write[Bag],
    item: Write[Item],
    uses: Write[ItemUsed],
    use: Read[Use],
    entities: Read[Entity],
    agents: Rows[Side, Bag],
    items: Rows[Item],
) -> None:
    """Take the last item out of the bag and record its user; the item's mechanic acts on that in phase EFFECT."""
    for row in items:
        item.user[row] = -1
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e] and use.use[i]:
            row = pop(bag, item, e)
            if row >= 0:
                item.user[row] = e
                k = emit(uses)
                uses.agent[k], uses.item[k] = e, row
