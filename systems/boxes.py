"""Boxes: they stand in the way, break, and can be carried off and set up again."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Bag,
    Body,
    Box,
    BoxesPlaced,
    BoxItem,
    BoxItemView,
    BoxView,
    Guard,
    Health,
    Item,
    Phase,
    Shape,
    Side,
    Solid,
    Spawned,
    Told,
)
from outlast.components.health import MOST
from outlast.components.inventory import last, lay
from outlast.components.sight import told
from outlast.ecs import (
    Add,
    Archetype,
    Array,
    Bitset,
    Entity,
    Layout,
    Module,
    Random,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    kernel,
    number,
)
from outlast.ecs.random import NORMAL, normal

from .inner.places import ROUNDED, laid, moved
from .inner.sweep import row, span

HALF = np.float32(0.5)
ROLLED = 1  # index into the choices of Boxes.corners


@dataclass(frozen=True)
class Boxes(Module):
    """Breakable rectangles of random shape (paper, section 3.2).

    Sides are normal draws, clipped below; a deviation of 0 makes all boxes alike. owned: who breaks a box first owns
    it, and from then on only that side can break it. offset: where a used item sets the box up, ahead of its user; the
    paper says at the user's own place, its runs had 0.75 (reference rules, section 6, point 6).

    Of two rules the paper says nothing, and its runs had the second of each. settles: a strike does harm to a box in
    the tick in which it is set up, or (True) not yet. corners: the vertices of what an agent sees begin at the lower
    left, or ("rolled") one corner later for items, and for boxes that were set up from one.
    """

    count: int = number(8, low=1)
    width: float = number(1.0, above=0)  # metres, mean
    width_deviation: float = number(1.0, low=0)
    height: float = number(1.5, above=0)
    height_deviation: float = number(1.5, low=0)
    least: float = number(0.1, low=0.003)  # metres, shortest side
    toughness: int = number(5, low=1, high=MOST)  # hit points
    owned: bool = number(True)
    dynamic: bool = number(False)  # can be pushed
    density: float = number(1.0, above=0)  # kilograms per square metre
    offset: float = number(0.0, low=0)  # metres from the user's centre
    item_radius: float = number(0.25, low=0.002)  # metres
    settles: bool = number(False)  # takes no harm in the tick in which it is set up
    corners: str = number("lower left", choices=("lower left", "rolled"))

    def archetypes(self) -> Iterable[Archetype]:
        solid = Solid(dynamic=self.dynamic, density=self.density)
        box = (Body(), Shape(), solid, Spawned(), Box(), Guard(), Health(points=self.toughness))
        item = (Body(), Shape(radius=self.item_radius), Item(), BoxItem(index=np.arange(self.count)))
        return [Archetype("box", box, self.count), Archetype("box_item", item, self.count, alive=False)]

    def singletons(self) -> Iterable[Singleton]:
        return [BoxView(), BoxItemView(), BoxesPlaced()]

    def dims(self) -> dict[str, int | str]:
        return {"boxes": self.count}

    def check(self, layout: Layout) -> None:
        layout.check_count(Box, "boxes")
        layout.check_count(BoxItem, "boxes")

    def bounds(self, layout: Layout) -> Mapping[str, tuple[Any, Any]]:
        """A box may be set up in a wall, and leaves its item there."""
        sides = (self.width, self.width_deviation), (self.height, self.height_deviation)
        half = [max(self.least, mean + NORMAL * deviation) / 2 * ROUNDED for mean, deviation in sides]
        corners, box = half * 4, (moved(layout) + self.offset) * ROUNDED
        item = max(box, laid(layout))
        known = {"boxes": [*corners, box, box, math.inf], "box_items": [*corners, item, item], "box_slot": corners}
        return {key: (np.negative(far), far) for key, far in known.items()}


@Boxes.system(Phase.DRAW)
def shape_boxes(
    shape: Write[Shape],
    boxes: Rows[Box],
    width: float,
    width_deviation: float,
    height: float,
    height_deviation: float,
    least: float,
    key: Random,
) -> None:
    """Width and height of each box, for the whole episode."""
    for k in range(boxes.size):
        e = boxes[k]
        shape.half_width[e] = HALF * max(least, width + width_deviation * normal(key, 2 * k))
        shape.half_height[e] = HALF * max(least, height + height_deviation * normal(key, 2 * k + 1))


@Boxes.system(Phase.RESPAWN)
def drop_item(
    box: Write[Box], entities: Write[Entity], body: Write[Body], boxes: Rows[Box], items: Rows[BoxItem]
) -> None:
    """A box that broke in the tick before lies on the ground as an item."""
    for k in range(boxes.size):
        e = boxes[k]
        if box.broken[e]:
            box.broken[e] = 0
            lay(body, entities, items[k], body.x[e], body.y[e])


@Boxes.system(Phase.EFFECT)
def set_up(
    body: Write[Body],
    entities: Write[Entity],
    box: Write[Box],
    placed: Add[BoxesPlaced],
    item: Read[Item],
    boxes: Rows[Box],
    items: Rows[BoxItem],
    offset: float,
) -> None:
    """A used item becomes its box again, upright, wherever that is: contacts will push out whoever stands there."""
    for k in range(items.size):
        user = item.user[items[k]]
        if user < 0:
            continue
        e = boxes[k]
        lay(body, entities, e, body.x[user] + offset * body.cosine[user], body.y[user] + offset * body.sine[user])
        body.angle[e], body.cosine[e], body.sine[e] = 0, 1, 0
        body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0
        box.placed[e], box.fresh[e] = 1, 1
        placed.boxes_placed[0] += 1


@Boxes.system(Phase.BREAK)
def break_boxes(
    box: Write[Box],
    entities: Write[Entity],
    health: Write[Health],
    guard: Write[Guard],
    boxes: Rows[Box],
    toughness: int,
    owned: bool,
    settles: bool,
) -> None:
    """Boxes without health are gone; the first breaker owns them. What comes back is as good as new."""
    for e in boxes:
        if settles and box.fresh[e]:
            health.points[e] = np.int32(toughness)
        box.fresh[e] = 0
        if entities.alive[e] and health.points[e] <= 0:
            entities.alive[e] = 0
            box.broken[e] = 1
            health.points[e] = np.int32(toughness)
            if owned and guard.heeds[e] < 0:
                guard.heeds[e] = health.source[e]


@kernel
def outline(row: Array, shape: Array, e: int, rolled: bool) -> None:
    """Fill 8 numbers: the vertices of box `e` as if centred at the origin, counter-clockwise.

    They begin at the lower left; rolled: at the lower right.
    """
    x, y = shape.half_width[e], shape.half_height[e]
    k = 6 if rolled else 0
    row[k], row[k + 1] = -x, -y
    k = 0 if rolled else 2
    row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4], row[k + 5] = x, -y, x, y, -x, y


@Boxes.system(Phase.OBSERVE)
def see_boxes(
    view: Write[BoxView],
    tell: Read[Told],
    body: Read[Body],
    shape: Read[Shape],
    box: Read[Box],
    agents: Rows[Side],
    boxes: Bitset[Box],
    index: RowIndex[Box],
    corners: int,
) -> None:
    """Boxes that stand."""
    first, last = span(boxes)
    for i in range(agents.size):
        for g in range(first, last):
            left = tell.stale[i, g] & boxes[g]
            while left:
                e = row(g, left)
                left &= left - 1
                k = index[e]
                view.boxes_mask[i, k] = told(tell.masks, i, e)
                if told(tell.filled, i, e):
                    outline(view.boxes[i, k, :8], shape, e, corners == ROLLED and box.placed[e] != 0)
                    view.boxes[i, k, 8], view.boxes[i, k, 9], view.boxes[i, k, 10] = body.x[e], body.y[e], body.angle[e]
                else:
                    view.boxes[i, k, :] = 0


@Boxes.system(Phase.OBSERVE)
def see_items(
    view: Write[BoxItemView],
    tell: Read[Told],
    body: Read[Body],
    shape: Read[Shape],
    agents: Rows[Side],
    boxes: Rows[Box],
    items: Bitset[BoxItem],
    index: RowIndex[BoxItem],
    corners: int,
) -> None:
    """Broken boxes on the ground."""
    first, last = span(items)
    for i in range(agents.size):
        for g in range(first, last):
            left = tell.stale[i, g] & items[g]
            while left:
                e = row(g, left)
                left &= left - 1
                k = index[e]
                view.box_items_mask[i, k] = told(tell.masks, i, e)
                if told(tell.filled, i, e):
                    outline(view.box_items[i, k, :8], shape, boxes[k], corners == ROLLED)
                    view.box_items[i, k, 8], view.box_items[i, k, 9] = body.x[e], body.y[e]
                else:
                    view.box_items[i, k, :] = 0


@Boxes.system(Phase.OBSERVE, after="boxes.see_items")
def see_slot(
    view: Write[BoxItemView],
    bag: Read[Bag],
    entities: Read[Entity],
    shape: Read[Shape],
    agents: Rows[Bag],
    boxes: Rows[Box],
    index: RowIndex[BoxItem],
    corners: int,
) -> None:
    """The last slot of the bag, if it holds a box item."""
    for i in range(agents.size):
        e = agents[i]
        thing = last(bag, e)
        held = entities.alive[e] != 0 and thing >= 0 and index[thing] >= 0
        view.box_slot_mask[i, 0] = 1 if held else 0
        view.box_slot[i, 0, :] = 0
        if held:
            outline(view.box_slot[i, 0], shape, boxes[index[thing]], corners == ROLLED)
