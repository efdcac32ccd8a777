"""A conveyor: whatever stands on the belt is carried along, and agents can walk against it."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Look, Phase, Seconds, Shape, Solid
from outlast.ecs import Archetype, Bitset, Component, Module, Rows, Write, number
from outlast.queries import Bodies, within


class Belt(Component):
    """A mark on the floor."""


@dataclass(frozen=True)
class Conveyor(Module):
    """The belt leads to the right. It is no solid, so nothing bumps into it."""

    speed: float = number(1.5, unit="metres per second", about="how fast it carries")

    def archetypes(self):
        """It lies across the yard."""
        return [Archetype("belt", (Body(), Shape(half_width=4.0, half_height=0.8), Belt()), 1)]

    def looks(self):
        """Grey."""
        return {"belt": Look(color=(200, 200, 190))}


@Conveyor.system(Phase.MOVE, after=("room", Body))
def carry(
    body: Write[Body], belts: Rows[Belt], solids: Bitset[Solid], bodies: Bodies, seconds: Seconds, speed: float
) -> None:
    """Move what overlaps the belt, as far as its centre is on it."""
    for belt in belts:
        for k in range(within(bodies, solids, belt, 0.0)):
            e = bodies.rows[k]
            if abs(body.x[e]) < 4.0 and abs(body.y[e]) < 0.8:
                body.x[e] += speed * seconds


CONVEYOR = yard("conveyor", Conveyor())
