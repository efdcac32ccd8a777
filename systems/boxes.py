"""Boxes: obstacles that break, and can be carried and set up again."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Body,
    Box,
    BoxBroken,
    BoxesPlaced,
    BoxItem,
    BoxItemView,
    BoxPlaced,
    BoxView,
    Guard,
    Health,
    Hit,
    Item,
    Phase,
    Shape,
    Solid,
    Spawned,
)
from outlast.components.health import MOST, fatal_agent
from outlast.components.inventory import place
from outlast.components.limits import FAR, HEAVY, LIGHT, MANY
from outlast.ecs import (
    INDEX,
    Add,
    Archetype,
    Array,
    Clock,
    Entity,
    Layout,
    Module,
    Random,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    emit,
    kernel,
    number,
    of,
    ref,
)
from outlast.ecs.kernels.random import NORMAL, normal

from .geometry.bounds import ROUNDING, check_fits, ends, farthest_body, farthest_item
from .observation_rows import observe

HALF = np.float32(0.5)
ROLLED = 1  # index into the choices of Boxes.corners


@dataclass(frozen=True)
class Boxes(Module):
    """Breakable rectangles of random shape (paper, section 3.2).

    Their sides are drawn from a normal distribution, clipped below; a deviation of 0 makes all boxes alike. owned:
    the side that breaks a box first owns it, and only that side can break it later. offset: distance ahead of its user
    at which an item sets up the box; 0 in the paper's text, 0.75 in its runs (reference rules, section 6,
    point 6).

    Two rules are not in the paper; its runs had the second value of each. settles: a box can be damaged in the tick in
    which it is set up, or (True) only later. corners: observed vertices begin at the lower left, or ("rolled") one
    corner later for items, and for boxes that were set up from items.
    """

    count: int = number(8, low=0, high=MANY, about="number of boxes")
    width: float = number(1.0, above=0, high=FAR, unit="metres", about="mean width of a box")
    width_deviation: float = number(
        1.0, low=0, high=FAR, unit="metres", about="standard deviation of widths; 0: all boxes are alike"
    )
    height: float = number(1.5, above=0, high=FAR, unit="metres", about="mean height of a box")
    height_deviation: float = number(
        1.5, low=0, high=FAR, unit="metres", about="standard deviation of heights; 0: all boxes are alike"
    )
    least: float = number(0.1, low=0.003, high=FAR, unit="metres", about="shortest side that a box can have")
    toughness: int = number(5, low=1, high=MOST, unit="hit points", about="damage that breaks a box")
    owned: bool = number(
        True, about="the side that first breaks a box owns it, and only that side can break it from then on"
    )
    dynamic: bool = number(False, about="boxes can be pushed")
    density: float = number(
        1.0, low=LIGHT, high=HEAVY, unit="kilograms per square metre", about="density of a box that can be pushed"
    )
    offset: float = number(
        0.0,
        low=0,
        high=FAR,
        per_agent=True,
        unit="metres",
        about="distance from the user's centre to the place where a box is set up",
    )
    item_radius: float = number(0.25, low=0.002, high=FAR, unit="metres", about="radius of a broken box on the ground")
    settles: bool = number(False, about="a box cannot be damaged in the tick in which it is set up")
    corners: str = number(
        "lower left",
        choices=("lower left", "rolled"),
        about="first observed vertex: lower left, or for items and boxes set up from them one corner later (rolled)",
    )

    def archetypes(self) -> Iterable[Archetype]:
        solid = Solid(dynamic=ref("dynamic"), density=ref("density"))
        box = (Body(), Shape(), solid, Spawned(), Box(), Guard(), Health(points=ref("toughness")))
        item = (Body(), Shape(radius=ref("item_radius")), Item(), BoxItem(index=INDEX))
        return [
            Archetype("box", box, ref("count"), order=20),
            Archetype("box_item", item, ref("count"), alive=False, order=30),
        ]

    def singletons(self) -> Iterable[Singleton]:
        return [BoxView(), BoxItemView(), BoxesPlaced(), BoxPlaced(), BoxBroken(), Hit()]

    def dims(self) -> dict[str, int | str]:
        return {"boxes": ref("count")}

    def check(self, layout: Layout) -> None:
        layout.check_count(Box, "boxes")
        layout.check_count(BoxItem, "boxes")
        check_fits(layout, "boxes.item_radius", self.item_radius, 2 * self.item_radius)
        for name in ("width", "width_deviation", "height", "height_deviation", "least"):
            check_fits(layout, f"boxes.{name}", getattr(self, name), getattr(self, name))

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        """Return bounds of places, which include walls: a box may be set up in a wall, and leave its item there."""
        sides = (self.width, self.width_deviation), (self.height, self.height_deviation)
        half = [max(self.least, mean + NORMAL * deviation) / 2 * ROUNDING for mean, deviation in sides]
        vertices, (x, y) = np.array(half * 4), farthest_body(layout)
        box, item = ((x + self.offset) * ROUNDING, (y + self.offset) * ROUNDING), farthest_item(layout)
        slot = {"vertices": (-vertices, vertices)}
        boxes, items = (slot | ends(far) for far in (box, max(box, item)))
        return {"boxes": boxes, "box_items": items, "box_slot": slot}


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
    """Draw width and height of each box, for the episode."""
    for k in range(boxes.size):
        e = boxes[k]
        shape.half_width[e] = HALF * max(least, width + width_deviation * normal(key, 2 * k))
        shape.half_height[e] = HALF * max(least, height + height_deviation * normal(key, 2 * k + 1))


@Boxes.system(Phase.RESPAWN)
def drop_item(
    box: Write[Box], entities: Write[Entity], body: Write[Body], boxes: Rows[Box], items: Rows[BoxItem]
) -> None:
    """Put boxes that broke in the previous tick on the ground as items."""
    for k in range(boxes.size):
        e = boxes[k]
        if box.broken[e]:
            box.broken[e] = 0
            place(body, entities, items[k], body.x[e], body.y[e])


@Boxes.system(Phase.EFFECT)
def set_up(
    body: Write[Body],
    entities: Write[Entity],
    box: Write[Box],
    placed: Add[BoxesPlaced],
    events: Write[BoxPlaced],
    item: Read[Item],
    boxes: Rows[Box],
    items: Rows[BoxItem],
    offset: float,
) -> None:
    """Turn used items into boxes again, upright, at any place: contacts push out bodies that overlap them."""
    for k in range(items.size):
        user = item.user[items[k]]
        if user < 0:
            continue
        e = boxes[k]
        far = of(offset, user)
        place(body, entities, e, body.x[user] + far * body.cosine[user], body.y[user] + far * body.sine[user])
        body.angle[e], body.cosine[e], body.sine[e] = 0, 1, 0
        body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0
        box.placed[e], box.fresh[e] = 1, 1
        placed.boxes_placed[0] += 1
        n = emit(events)
        events.agent[n], events.box[n] = user, e


@Boxes.system(Phase.BREAK)
def break_boxes(
    box: Write[Box],
    entities: Write[Entity],
    health: Write[Health],
    guard: Write[Guard],
    events: Write[BoxBroken],
    hits: Read[Hit],
    clock: Read[Clock],
    boxes: Rows[Box],
    toughness: int,
    owned: bool,
    settles: bool,
) -> None:
    """Remove boxes without health; the first side to break one owns it. Health is restored for the next time."""
    for e in boxes:
        if settles and box.fresh[e]:
            health.points[e] = np.int32(toughness)
        box.fresh[e] = 0
        if entities.alive[e] and health.points[e] <= 0:
            entities.alive[e] = 0
            box.broken[e] = 1
            k = emit(events)
            events.box[k], events.by[k] = e, fatal_agent(health, hits, e, clock.tick[0])
            events.side[k] = health.source[e]
            health.points[e] = np.int32(toughness)
            if owned and guard.vulnerable_only_to[e] < 0:
                guard.vulnerable_only_to[e] = health.source[e]


@kernel
def outline(into: Array, shape: Array, e: int, rolled: bool) -> None:
    """Write the vertices of box `e` in its own frame, counter-clockwise; zeros for -1.

    They begin at the lower left, or, if `rolled`, at the lower right.
    """
    if e < 0:
        into[:8] = 0
        return
    x, y = shape.half_width[e], shape.half_height[e]
    k = 6 if rolled else 0
    into[k], into[k + 1] = -x, -y
    k = 0 if rolled else 2
    into[k], into[k + 1], into[k + 2], into[k + 3], into[k + 4], into[k + 5] = x, -y, x, y, -x, y


@kernel
def box_outline(i: int, e: int, into: Array, shape: Read[Shape], box: Read[Box], corners: int) -> None:
    """Write the vertices of a standing box."""
    outline(into, shape, e, corners == ROLLED and e >= 0 and box.placed[e] != 0)


@kernel
def item_outline(
    i: int, e: int, into: Array, shape: Read[Shape], boxes: Rows[Box], index: RowIndex[BoxItem], corners: int
) -> None:
    """Write the vertices of an item's box."""
    outline(into, shape, boxes[index[e]] if e >= 0 else -1, corners == ROLLED)


observe(Boxes, BoxView, "boxes", Box, vertices=box_outline, x=Body.x, y=Body.y, angle=Body.angle)
observe(Boxes, BoxItemView, "box_items", BoxItem, vertices=item_outline, x=Body.x, y=Body.y)
observe(Boxes, BoxItemView, "box_slot", BoxItem, vertices=item_outline)
