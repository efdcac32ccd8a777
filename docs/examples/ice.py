"""Ice: on one half of the floor nothing slows down."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Material, Phase, Side
from outlast.ecs import Archetype, Module, Read, Rows, Write


@dataclass(frozen=True)
class Ice(Module):
    """The right half of the floor is ice."""

    def archetypes(self):
        """Agents get a material, which changes with the floor below them."""
        return [Archetype("agent", (Material(),))]


@Ice.system(Phase.DRIVE, after=Body)
def slip(material: Write[Material], body: Read[Body], agents: Rows[Side]) -> None:
    """-1 stands for the number of physics."""
    for e in agents:
        material.linear_damping[e] = 0.0 if body.x[e] > 0 else -1.0


ICE = yard("ice", Ice())
