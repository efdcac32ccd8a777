"""Dropping at death: the items of an agent that dies are scattered around it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Bag, Body, Died, Item, ItemDropped, Phase
from outlast.components.inventory import place, pop
from outlast.components.limits import FAR
from outlast.ecs import Entity, Module, Random, Read, Rows, Singleton, Write, emit, number, of
from outlast.ecs.kernels.random import uniform2

TURN = np.float32(2 * math.pi)


@dataclass(frozen=True)
class DeathDrop(Module):
    """Loss of all items at death (paper, section 3.1).

    scatter = "disc": anywhere in a circle of `radius`, as in the paper's text. "rim": exactly on it, as in the paper's
    runs (reference rules, section 6, point 5).
    """

    stream = "drop"

    radius: float = number(
        0.5, low=0, high=FAR, per_agent=True, unit="metres", about="radius of a circle around the place of death"
    )
    scatter: str = number(
        "disc", choices=("disc", "rim"), about="items fall anywhere in that circle (disc), or exactly on it (rim)"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [ItemDropped()]


@DeathDrop.system(Phase.DIE, after=Died)
def scatter(
    bag: Write[Bag],
    item: Write[Item],
    body: Write[Body],
    entities: Write[Entity],
    drops: Write[ItemDropped],
    died: Read[Died],
    agents: Rows[Bag],
    items: Rows[Item],
    radius: float,
    scatter: int,
    key: Random,
) -> None:
    """Scatter the items of the dead, each in a random direction of its own."""
    for e in agents:
        while died.now[e] and bag.count[e] > 0:
            row = pop(bag, item, e)
            direction, far = uniform2(key, entities.identity[row])
            distance = of(radius, e) * np.float32(np.sqrt(far)) if scatter == 0 else of(radius, e)
            x = body.x[e] + distance * np.float32(np.cos(TURN * direction))
            y = body.y[e] + distance * np.float32(np.sin(TURN * direction))
            place(body, entities, row, x, y)
            k = emit(drops)
            drops.agent[k], drops.item[k] = e, row
