"""A ramp: whoever comes from it is aloft for a while, and moves over low walls."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Filter, Phase, Shape, Side, Solid
from outlast.components.contact import ALL
from outlast.ecs import Archetype, Array, Component, Module, Read, Rows, Write, column, number

LOW = 2  # the layer of low walls


class Aloft(Component):
    """How high an agent is."""

    ticks: Array = column("i4", low=0)  # for which it stays aloft


class Ramp(Component):
    """A mark on the floor."""


@dataclass(frozen=True)
class Ramps(Module):
    """A ramp stands in front of a low wall."""

    reach: float = number(0.8, above=0, unit="metres", about="distance from the middle of a ramp within which it lifts")
    ticks: int = number(30, low=1, unit="ticks", about="how long an agent stays aloft")

    def archetypes(self):
        """The ramp is no solid, so that it is in nobody's way."""
        wall = Body(x=1.5), Shape(half_width=0.2, half_height=6.0), Solid(), Filter(layer=LOW)
        return [
            Archetype("agent", (Filter(), Aloft())),
            Archetype("low_wall", wall, 1),
            Archetype("ramp", (Body(), Ramp()), 1),
        ]


@Ramps.system(Phase.DRIVE, after=Body)
def climb(
    aloft: Write[Aloft],
    filters: Write[Filter],
    body: Read[Body],
    agents: Rows[Side],
    ramps: Rows[Ramp],
    reach: float,
    ticks: int,
) -> None:
    """Agents that are aloft do not hit what is low."""
    for e in agents:
        aloft.ticks[e] = max(aloft.ticks[e] - 1, 0)
        for ramp in ramps:
            x, y = body.x[e] - body.x[ramp], body.y[e] - body.y[ramp]
            if x * x + y * y < reach * reach:
                aloft.ticks[e] = ticks
        filters.hits[e] = ALL & ~LOW if aloft.ticks[e] > 0 else ALL


RAMP = yard("ramp", Ramps())
