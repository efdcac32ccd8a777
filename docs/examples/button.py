"""A button that opens a door: while somebody stands on the plate, the door slides away."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Driven, Look, Phase, Shape, Side, Solid
from outlast.ecs import Archetype, Array, Bitset, Component, Module, Rows, Write, column, number
from outlast.queries import Bodies, within


class Plate(Component):
    """A mark on the floor."""

    pressed: Array = column("u1", high=1)


@dataclass(frozen=True)
class Button(Module):
    """The door closes a gap in a wall, and slides up to open it."""

    speed: float = number(2.0, above=0, unit="metres per second", about="how fast the door slides")

    def archetypes(self):
        """Two walls with a gap of two metres, the door in it, and the plate on the left."""
        wall = Body(y=[3.5, -3.5]), Shape(half_width=0.1, half_height=2.5), Solid()
        door = Body(), Shape(half_width=0.1, half_height=1.0), Solid(), Driven()
        plate = Body(x=-3.0, y=2.0), Shape(half_width=0.5, half_height=0.5), Plate()
        return [Archetype("gate", wall, 2), Archetype("door", door, 1), Archetype("plate", plate, 1)]

    def looks(self):
        """A ring around a plate that is pressed."""
        return {"plate": Look(ring=Plate.pressed), "door": Look(color=(150, 90, 40))}


@Button.system(Phase.DRIVE, after=Body)
def slide(
    body: Write[Body],
    plate: Write[Plate],
    plates: Rows[Plate],
    doors: Rows[Driven],
    agents: Bitset[Side],
    bodies: Bodies,
    speed: float,
) -> None:
    """Driven bodies move at their velocity: up to 2 metres, and back."""
    for e in plates:
        plate.pressed[e] = within(bodies, agents, e, 0.0) > 0
    for e in doors:
        aim = 2.0 if plate.pressed[plates[0]] else 0.0
        body.vy[e] = min(max(4 * (aim - body.y[e]), -speed), speed)


BUTTON = yard("button", Button(), agents=2)
