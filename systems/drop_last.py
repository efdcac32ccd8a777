"""Dropping by choice: an optional action that puts the last item of the bag on the ground."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Bag, Body, Drop, Gift, Item, ItemDropped, Phase, Side
from outlast.components.inventory import empty, empty_handed, place, pop
from outlast.components.limits import FAR
from outlast.components.respawn import inactive
from outlast.ecs import Entity, Module, Read, Rows, Singleton, WorldsView, Write, emit, number, of


@dataclass(frozen=True)
class DropLast(Module):
    """The action `drop` (paper, section 3.1; the paper's runs do not have it).

    The item lands ahead of the agent; if `offset` is less than the reach of pickup, it returns to the bag at once.
    """

    offset: float = number(
        1.0,
        low=0,
        high=FAR,
        per_agent=True,
        unit="metres",
        about="distance ahead of the agent's centre at which it drops an item",
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Drop(), ItemDropped()]

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        return {"drop": inactive(worlds) | empty_handed(worlds, received=Gift in worlds)}


@DropLast.system(Phase.GIVE, after=Bag)
def drop_last(
    bag: Write[Bag],
    item: Write[Item],
    body: Write[Body],
    entities: Write[Entity],
    drops: Write[ItemDropped],
    drop: Read[Drop],
    agents: Rows[Side, Bag],
    items: Rows[Item],
    offset: float,
) -> None:
    """Put the last item down, straight ahead."""
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e] and drop.drop[i] and not empty(bag, e):
            row, far = pop(bag, item, e), of(offset, e)
            place(body, entities, row, body.x[e] + far * body.cosine[e], body.y[e] + far * body.sine[e])
            k = emit(drops)
            drops.agent[k], drops.item[k] = e, row
