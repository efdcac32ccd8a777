"""Boxes: breakable objects, and the items they turn into. Box k and box item k are one object in two states."""

from outlast.ecs import Array, Component, Event, Observation, Statistic, column


class Box(Component):
    """An intact box while alive."""

    broken: Array = column("u1")  # 1 for the one tick between box and item
    placed: Array = column("u1")  # 1 once it was placed from its item
    fresh: Array = column("u1")  # 1 in the tick in which it is placed, until boxes break


class BoxItem(Component):
    """A broken box, on the ground or in a bag. Its shape is that of box `index`."""

    index: Array = column("i4")


class BoxView(Observation):
    """Boxes: four vertices as if centred at the origin (8), x, y, angle. Mask: 1 = visible."""

    boxes: Array = column("f4", "agents", "boxes", 11)
    boxes_mask: Array = column("f4", "agents", "boxes", low=0, high=1)


class BoxItemView(Observation):
    """Broken boxes on the ground: vertices (8), x, y; and the last slot if it holds one: vertices."""

    box_items: Array = column("f4", "agents", "boxes", 10)
    box_items_mask: Array = column("f4", "agents", "boxes", low=0, high=1)
    box_slot: Array = column("f4", "agents", 1, 8)
    box_slot_mask: Array = column("f4", "agents", 1, low=0, high=1)


class BoxesPlaced(Statistic):
    """Boxes placed from their item in this episode, by anybody."""

    boxes_placed: Array = column("i4")


class BoxPlaced(Event, capacity=Box, whom="box"):
    """A box that was set up from its item."""

    agent: Array = column("i4", unit="entity")
    box: Array = column("i4", unit="entity")


class BoxBroken(Event, capacity=Box, who="by", whom="box"):
    """A box that broke."""

    box: Array = column("i4", unit="entity")
    by: Array = column("i4", unit="entity")  # the agent whose hit of this tick it was, -1: nobody's
    side: Array = column("i4", unit="side")  # the side that did it, -1: none
