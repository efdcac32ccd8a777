"""A one-way door: agents pass it from left to right, and then it is a wall for them."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Filter, Phase, Shape, Side, Solid
from outlast.components.contact import ALL
from outlast.ecs import Archetype, Component, Module, Read, Rows, Write

DOOR = 2  # the layer of doors


class Door(Component):
    """A wall along the y axis."""


@dataclass(frozen=True)
class OneWayDoor(Module):
    """Whether an agent hits doors is a bit of its filter, which changes with the side that it is on."""

    def archetypes(self):
        """Agents get a filter, and the door is in a layer of its own."""
        solid = Body(), Shape(half_width=0.1, half_height=6.0), Solid(), Filter(layer=DOOR)
        return [Archetype("agent", (Filter(),)), Archetype("door", (*solid, Door()), 1)]


@OneWayDoor.system(Phase.DRIVE, after=Body)
def open_and_close(filters: Write[Filter], body: Read[Body], agents: Rows[Side], doors: Rows[Door]) -> None:
    """An agent does not hit the door while its centre is on the left of the door's."""
    for e in agents:
        for door in doors:
            filters.hits[e] = ALL & ~DOOR if body.x[e] < body.x[door] else ALL


ONE_WAY_DOOR = yard("one_way_door", OneWayDoor())
