"""A trap that senses: whoever steps on it is held, and can be freed by nobody."""

from dataclasses import dataclass

from yard import yard

from outlast import systems
from outlast.components import Body, Filter, Phase, Shape, Side, Solid, Touch
from outlast.components.contact import fix
from outlast.ecs import Archetype, Component, Module, Read, RowIndex, Write


class Trap(Component):
    """A plate on the floor."""


@dataclass(frozen=True)
class Traps(Module):
    """The plate is a sensor: it touches what is on it, and is in nobody's way."""

    def archetypes(self):
        """A solid in layer 1, as agents hit it."""
        plate = Body(x=1.0), Shape(half_width=0.5, half_height=0.5), Solid(), Filter(sensor=1), Trap()
        return [Archetype("trap", plate, 1)]


@Traps.system(Phase.LOOK)
def catch(
    solid: Write[Solid], body: Write[Body], touches: Read[Touch], traps: RowIndex[Trap], agents: RowIndex[Side]
) -> None:
    """Touches are filled by physics, in games with Contacts; agents have smaller rows than traps."""
    for k in range(touches.count[0]):
        e, o = touches.solid[k], touches.other[k]
        if touches.began[k] and agents[e] >= 0 and traps[o] >= 0:
            fix(solid, body, e)


TRAP = yard("trap", Traps(), systems.Contacts())
