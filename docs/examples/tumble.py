"""Tumbling stones: a blade turns in the middle of the yard, and sweeps triangles and other polygons around."""

import math
from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Driven, Filter, Look, Material, Polygon, Push, Solid
from outlast.ecs import Archetype, Module

TRIANGLE = [(0.0, 0.0), (1.2, 0.0), (0.0, 0.8)]
PENTAGON = [(0.6 * math.cos(math.tau * k / 5), 0.6 * math.sin(math.tau * k / 5)) for k in range(5)]
OCTAGON = [(0.6 * math.cos(math.tau * k / 8), 0.6 * math.sin(math.tau * k / 8)) for k in range(8)]
BLADE = [(-2.5, 0.0), (0.0, -0.25), (2.5, 0.0), (0.0, 0.25)]


@dataclass(frozen=True)
class Tumble(Module):
    """Stones have the shapes that their kind lists, one each, and hardly any friction."""

    def archetypes(self):
        """The body of a polygon is where its centre of mass is."""
        stone = Push(), Solid(dynamic=1), Material(friction=0.05, restitution=0.4, linear_damping=0.3), Filter()
        places = Body(x=[2.6, -2.6, 0.5, -0.5, 3.5, -3.5], y=[0.9, -0.9, 2.6, -2.6, -3.0, 3.0])
        shapes = Polygon([TRIANGLE, TRIANGLE, PENTAGON, PENTAGON, OCTAGON, OCTAGON])
        blade = Body(omega=1.5), Polygon(BLADE), Solid(), Driven()
        return [Archetype("stone", (places, shapes, *stone), 6), Archetype("blade", blade, 1)]

    def looks(self):
        """Red."""
        return {"blade": Look(color=(190, 60, 50))}


TUMBLE = yard("tumble", Tumble())
