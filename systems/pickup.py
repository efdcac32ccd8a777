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
    Real,
    Rows,
    Scratch,
    Singleton,
    Write,
    emit,
    kernel,
    number,
    of,
)
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, to_bits

from .geometry.blocks import BITS, BLOCK, append_rows, nonempty_blocks
from .geometry.spatial_index import FEW, build, make_scratch, query


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
        return make_scratch(name, dims)


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
    sides: Scratch,
    scale: Scratch,
    words: Scratch,
    rows: Scratch,
    reach: float,
    touch: bool,
) -> None:
    """Pick up items, in order of agents, then of items; those that do not fit stay where they are."""
    count = nonempty_blocks(blocks, entities, items)
    index, crowded = (blocks, sides, scale, words, rows), count > FEW
    if crowded:
        build(index, count, (body.x, body.y, shape.radius, shape.radius))
    for e in agents:
        if not entities.alive[e]:
            continue
        x, y, far = body.x[e], body.y[e], of(reach, e)
        if crowded:
            found = query(index, count, x - far, x + far, y - far, y + far)
        else:
            found = list_near(rows, blocks, count, body, shape, x, y, far)
        for n in range(found):
            row = rows[n]
            dx, dy, most = body.x[row] - x, body.y[row] - y, shape.radius[row] * np.float32(touch) + far
            if entities.alive[row] and dx * dx + dy * dy <= most * most and push(bag, item, e, row):
                entities.alive[row] = 0
                k = emit(picks)
                picks.agent[k], picks.item[k] = e, row


@kernel
def list_near(rows: Array, blocks: Array, count: int, body: Array, shape: Array, x: Real, y: Real, far: Real) -> int:
    """List the items whose discs are within `far` of a place; return how many."""
    found = 0
    for k in range(count):
        b = blocks[BLOCK, k]
        dx, dy = load(body.x, SIMD_WIDTH * b) - x, load(body.y, SIMD_WIDTH * b) - y
        most = load(shape.radius, SIMD_WIDTH * b) + far
        found = append_rows(rows, found, b, blocks[BITS, k] & to_bits(dx * dx + dy * dy <= most * most))
    return found
