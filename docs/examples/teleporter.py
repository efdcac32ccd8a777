"""A teleporter: two pads, and who steps on one stands on the other; it works again once the pads are empty."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Shape, Side
from outlast.ecs import Archetype, Array, Bitset, Component, Module, Rows, Write, column
from outlast.queries import Bodies, nearest


class Pad(Component):
    """A mark on the floor."""

    used: Array = column("u1", high=1)  # 1: somebody has come or gone, and still stands there


@dataclass(frozen=True)
class Teleporter(Module):
    """Pad 0 leads to pad 1 and back."""

    def archetypes(self):
        """Far apart."""
        return [Archetype("pad", (Body(x=[-4, 4], y=[-4, 4]), Shape(radius=0.6), Pad()), 2)]


@Teleporter.system(Phase.DRIVE, after=Body)
def beam(body: Write[Body], pad: Write[Pad], pads: Rows[Pad], agents: Bitset[Side], bodies: Bodies) -> None:
    """The index of bodies is of before anybody was moved."""
    on = (nearest(bodies, agents, pads[0], -0.0), nearest(bodies, agents, pads[1], -0.0))
    for k in range(2):
        if on[0] < 0 and on[1] < 0:
            pad.used[pads[k]] = 0
        elif on[k] >= 0 and on[1 - k] < 0 and not pad.used[pads[0]] and not pad.used[pads[1]]:
            body.x[on[k]], body.y[on[k]] = body.x[pads[1 - k]], body.y[pads[1 - k]]
            pad.used[pads[0]], pad.used[pads[1]] = 1, 1


TELEPORTER = yard("teleporter", Teleporter())
