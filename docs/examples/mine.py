"""Mines: who comes near is thrown back, and so is everything else around."""

import math
from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Shape, Side, Solid, Spawned
from outlast.ecs import Archetype, Bitset, Component, Entity, Module, Rows, Write, number, ref
from outlast.queries import Bodies, nearest, within


class Mine(Component):
    """It lies on the floor until it goes off."""


@dataclass(frozen=True)
class Mines(Module):
    """The count may be 0."""

    count: int = number(4, low=0, high=40, about="number of mines")
    near: float = number(0.3, low=0, unit="metres", about="how near an agent sets it off")
    blast: float = number(3.0, above=0, unit="metres", about="how far it reaches")
    speed: float = number(8.0, above=0, unit="metres per second", about="speed that it gives to what is near")

    def archetypes(self):
        """What has Spawned gets a place of its own."""
        return [Archetype("mine", (Body(), Shape(radius=0.2), Spawned(), Mine()), ref("count"))]


@Mines.system(Phase.DRIVE, after=Body)
def explode(
    body: Write[Body],
    entities: Write[Entity],
    mines: Rows[Mine],
    agents: Bitset[Side],
    solids: Bitset[Solid],
    bodies: Bodies,
    near: float,
    blast: float,
    speed: float,
) -> None:
    """Everything that can move flies off, away from the mine."""
    for mine in mines:
        if entities.alive[mine] and nearest(bodies, agents, mine, near) >= 0:
            entities.alive[mine] = 0
            for k in range(within(bodies, solids, mine, blast)):
                e = bodies.rows[k]
                x, y = body.x[e] - body.x[mine], body.y[e] - body.y[mine]
                far = max(math.hypot(x, y), 0.1)
                body.vx[e] += speed * x / far
                body.vy[e] += speed * y / far


MINES = yard("mines", Mines())
