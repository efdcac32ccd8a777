"""Pickup: agents take the items within their reach."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Body, Item, ItemPicked, Phase, Shape
from outlast.components.inventory import push
from outlast.components.limits import FAR
from outlast.ecs import (
    Array,
    Bitset,
    Entity,
    Module,
    Read,
    Rows,
    Singleton,
    Write,
    emit,
    kernel,
    number,
    of,
)
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, to_bits

from .geometry.blocks import alive_bits
from .geometry.bodies import FEW, Bodies, discs_near


@dataclass(frozen=True)
class Pickup(Module):
    """Pick up every item in reach, as long as the bag has room (paper, section 3.2).

    touch: whether it is enough that the item's disc touches the circle of reach, as the paper says; otherwise its
    centre must lie inside, as in the paper's runs (reference rules, section 6, point 3).
    """

    reach: float = number(
        0.5,
        above=0,
        high=FAR,
        per_agent=True,
        unit="metres",
        about="radius around the agent's centre in which it picks up items",
    )
    touch: bool = number(
        True, about="it is enough that the disc of the item touches that circle; otherwise its centre must be inside"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [ItemPicked()]


@Pickup.system(Phase.PICKUP)
def pick_up(
    bag: Write[Bag],
    item: Write[Item],
    entities: Write[Entity],
    picks: Write[ItemPicked],
    body: Read[Body],
    shape: Read[Shape],
    agents: Rows[Bag],
    items: Bitset[Item],
    bodies: Bodies,
    reach: float,
    touch: bool,
) -> None:
    """Pick up items, in order of agents, then of items; those that do not fit stay where they are."""
    if items.size <= FEW and not some_near(body, shape, entities, agents, items, reach, touch):
        return
    for e in agents:
        if not entities.alive[e]:
            continue
        x, y, far = body.x[e], body.y[e], of(reach, e)
        for n in range(discs_near(bodies, items, x, y, far)):
            row = bodies.rows[n]
            dx, dy, most = body.x[row] - x, body.y[row] - y, shape.radius[row] * np.float32(touch) + far
            if entities.alive[row] and dx * dx + dy * dy <= most * most and push(bag, item, e, row):
                entities.alive[row] = 0
                k = emit(picks)
                picks.agent[k], picks.item[k] = e, row


@kernel
def some_near(body: Array, shape: Array, entities: Array, agents: Array, items: Array, reach: Any, touch: bool) -> bool:
    """Return whether any item is within reach of any agent, which is seldom so."""
    near = 0
    for b in range(items.size):
        there = alive_bits(entities, items, b)
        if there:
            row = SIMD_WIDTH * b
            x, y, radius = load(body.x, row), load(body.y, row), load(shape.radius, row) * np.float32(touch)
            for e in agents:
                dx, dy, most = x - body.x[e], y - body.y[e], radius + of(reach, e)
                near |= (there if entities.alive[e] else 0) & to_bits(dx * dx + dy * dy <= most * most)
    return near != 0
