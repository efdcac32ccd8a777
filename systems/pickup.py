"""Pickup: agents take the items within their reach."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Body, Item, ItemPicked, Phase, Shape
from outlast.components.inventory import push
from outlast.components.limits import FAR
from outlast.ecs import Array, Bitset, Entity, Module, Read, Rows, Scratch, Singleton, Write, emit, kernel, number, of
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, to_bits

from .geometry.blocks import alive_bits, first_row


@dataclass(frozen=True)
class Pickup(Module):
    """Pickup of every item in reach, as long as the bag has room (paper, section 3.2).

    touch: whether the item's disc only has to touch the circle of reach, as in the paper's text; otherwise its
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

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        if name == "near":  # whether each holder of a bag has an item in reach
            return np.zeros(dims["rows"], np.uint8)
        return np.zeros(dims["rows"], np.int32)  # living: indices of living holders


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
    near: Scratch,
    living: Scratch,
    reach: float,
    touch: bool,
) -> None:
    """Pick up items, in order of agents, then of items; items that do not fit stay on the ground."""
    if not find_near(near, living, body, shape, entities, agents, items, reach, touch):
        return
    for i in range(agents.size):
        e = agents[i]
        for b in range(items.size if near[i] else 0):
            pending = alive_bits(entities, items, b) & in_reach(load_discs(body, shape, b, touch), body, e, reach)
            while pending:
                row = first_row(b, pending)
                pending &= pending - 1
                if push(bag, item, e, row):
                    entities.alive[row] = 0
                    k = emit(picks)
                    picks.agent[k], picks.item[k] = e, row


@kernel
def find_near(
    near: Array,
    living: Array,
    body: Array,
    shape: Array,
    entities: Array,
    agents: Array,
    items: Array,
    reach: Any,
    touch: bool,
) -> bool:
    """Mark the living agents with an item in reach, and return whether there are any, which is rare.

    Each block of items is loaded once, and tested against all of them.
    """
    some = count = 0
    for i in range(agents.size):
        near[i], living[count] = 0, i
        count += entities.alive[agents[i]] != 0
    for b in range(items.size):
        there = alive_bits(entities, items, b)
        if there:
            discs = load_discs(body, shape, b, touch)
            for k in range(count):
                found = there & in_reach(discs, body, agents[living[k]], reach)
                near[living[k]] |= found != 0
                some |= found
    return some != 0


@kernel
def load_discs(body: Array, shape: Array, b: int, touch: bool) -> Any:
    """Return places and radii of block `b`, three vectors; radii are 0 if the centre counts, not the touch."""
    row = SIMD_WIDTH * b
    return load(body.x, row), load(body.y, row), load(shape.radius, row) * np.float32(touch)


@kernel
def in_reach(discs: Any, body: Array, e: int, reach: Any) -> int:
    """Return the bitset of the discs of a block that agent `e` reaches."""
    x, y, radius = discs
    dx, dy, most = x - body.x[e], y - body.y[e], radius + of(reach, e)
    return int(to_bits(dx * dx + dy * dy <= most * most))
