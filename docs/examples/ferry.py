"""A ferry: a platform that goes to and fro, and carries who stands on it."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Look, Phase, Seconds, Shape, Side
from outlast.ecs import Archetype, Bitset, Component, Module, Read, Rows, Write, number
from outlast.queries import Bodies, around


class Platform(Component):
    """A part of the floor that moves."""


@dataclass(frozen=True)
class Ferry(Module):
    """It turns back at the ends of its way."""

    speed: float = number(1.0, above=0, unit="metres per second", about="how fast it goes")
    way: float = number(3.0, above=0, unit="metres", about="how far it goes to either side")

    def archetypes(self):
        """It is no solid: one stands on it."""
        return [Archetype("platform", (Body(vx=1.0), Shape(half_width=1.2, half_height=1.2), Platform()), 1)]

    def looks(self):
        """Wood."""
        return {"platform": Look(color=(210, 190, 150))}


@Ferry.system(Phase.MOVE, after=("room", Body))
def sail(
    body: Write[Body],
    shape: Read[Shape],
    platforms: Rows[Platform],
    agents: Bitset[Side],
    bodies: Bodies,
    seconds: Seconds,
    speed: float,
    way: float,
) -> None:
    """Whose centre is on the platform goes along."""
    for p in platforms:
        if abs(body.x[p]) > way:
            body.vx[p] = -1 if body.x[p] > 0 else 1
        step = body.vx[p] * speed * seconds
        for k in range(around(bodies, agents, body.x[p], body.y[p], 2.0)):
            e = bodies.rows[k]
            if abs(body.x[e] - body.x[p]) < shape.half_width[p] and abs(body.y[e] - body.y[p]) < shape.half_height[p]:
                body.x[e] += step
        body.x[p] += step


FERRY = yard("ferry", Ferry())
