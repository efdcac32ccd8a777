"""Inventory: a bag with a few slots, and the use of its last item."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Bag, Item, ItemUsed, Phase, Use
from outlast.components.inventory import pop
from outlast.components.limits import MANY
from outlast.ecs import Archetype, Entity, Module, Read, Rows, Singleton, Write, emit, number


@dataclass(frozen=True)
class Inventory(Module):
    """Bags of agents (paper, section 3.1): a stack, whose last item can be used."""

    slots: int = number(4, low=1, high=MANY, about="items that a bag holds")

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Bag(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Use(), ItemUsed()]

    def dims(self) -> dict[str, int | str]:
        return {"slots": self.slots}


@Inventory.system(Phase.USE)
def use_last(
    bag: Write[Bag],
    item: Write[Item],
    uses: Write[ItemUsed],
    use: Read[Use],
    entities: Read[Entity],
    agents: Rows[Bag],
    items: Rows[Item],
) -> None:
    """The last item leaves the bag, and its user is recorded; the item's mechanic acts on that in phase EFFECT."""
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
