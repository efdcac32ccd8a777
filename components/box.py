"""Boxes: breakable objects, and the items that they become. Box k and box item k are the same object in two states."""

import math

from outlast.ecs import Array, Component, Event, Field, Observation, Statistic, column

from .body import PLACE

VERTICES = Field("vertices", "m", scale=2.0, size=8)  # x, y of each, relative to the box's position


class Box(Component):
    """A box, which is intact while alive."""

    broken: Array = column("u1")  # 1 for the one tick between box and item
    placed: Array = column("u1")  # 1 once it has been placed from its item
    fresh: Array = column("u1")  # 1 in the tick in which it is placed, until phase BREAK


class BoxItem(Component):
    """A broken box, on the ground or in a bag. It has the shape of box `index`."""

    index: Array = column("i4", below="boxes")


class BoxView(Observation):
    """Standing boxes: four vertices in the box's own frame, its place and its angle. Mask: 1 = visible."""

    boxes: Array = column("f4", "agents", "boxes", fields=(VERTICES, *PLACE, Field("angle", "rad", scale=math.pi)))
    boxes_mask: Array = column("f4", "agents", "boxes", low=0, high=1)


class BoxItemView(Observation):
    """Broken boxes on the ground, and the last slot of the bag if it holds one."""

    box_items: Array = column("f4", "agents", "boxes", fields=(VERTICES, *PLACE))
    box_items_mask: Array = column("f4", "agents", "boxes", low=0, high=1)
    box_slot: Array = column("f4", "agents", 1, fields=(VERTICES,))
    box_slot_mask: Array = column("f4", "agents", 1, low=0, high=1)


class BoxesPlaced(Statistic):
    """The number of boxes that all agents have set up from items in this episode."""

    boxes_placed: Array = column("i4")


class BoxPlaced(Event, capacity=Box, whom="box"):
    """A box was set up from its item."""

    agent: Array = column("i4", unit="entity")
    box: Array = column("i4", unit="entity")


class BoxBroken(Event, capacity=Box, who="by", whom="box"):
    """A box broke."""

    box: Array = column("i4", unit="entity")
    by: Array = column("i4", unit="entity")  # the agent whose hit broke it in this tick, -1: none
    side: Array = column("i4", unit="side")  # the side that broke it, -1: none
