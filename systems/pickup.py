"""Pickup: agents take the items within their reach."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Body, Item, ItemPicked, Phase, Shape
from outlast.components.inventory import push
from outlast.components.limits import FAR
from outlast.ecs import Bitset, Entity, Module, Read, Rows, Scratch, Singleton, Write, emit, number, of
from outlast.ecs.simd import SIMD_WIDTH, load, to_bits

from .geometry.blocks import BITS, BLOCK, first_row, make_blocks, nonempty_blocks, without_row


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

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return make_blocks(dims)


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
    blocks: Scratch,
    reach: float,
    touch: bool,
) -> None:
    """Pick up items, in order of agents, then of items; those that do not fit stay where they are."""
    count = nonempty_blocks(blocks, entities, items)
    for e in agents:
        if not entities.alive[e]:
            continue
        for k in range(count):
            b = blocks[BLOCK, k]
            x, y = load(body.x, SIMD_WIDTH * b) - body.x[e], load(body.y, SIMD_WIDTH * b) - body.y[e]
            far = load(shape.radius, SIMD_WIDTH * b) * np.float32(touch) + of(reach, e)
            pending = blocks[BITS, k] & to_bits(x * x + y * y <= far * far)
            while pending:
                row = first_row(b, pending)
                pending &= pending - 1
                if push(bag, item, e, row):
                    entities.alive[row] = 0
                    n = emit(picks)
                    picks.agent[n], picks.item[n] = e, row
                    blocks[BITS, k] = without_row(blocks[BITS, k], b, row)
