"""Grabbing: an agent welds the nearest crate in reach to itself, and carries it for as long as it wants to."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Shape, Solid, Weld
from outlast.components.joint import hold, let_go
from outlast.ecs import Action, Archetype, Array, Component, Entity, Module, Read, Rows, Write, column, number


class Crate(Component):
    """What can be grabbed."""


class Grab(Action):
    """1: hold on to a crate, 0: let go."""

    grab: Array = column("i1", "agents", low=0, high=1)


@dataclass(frozen=True)
class Grabbing(Module):
    """Several agents may hold one crate."""

    reach: float = number(1.5, above=0, unit="metres", about="greatest distance between centres")

    def archetypes(self):
        """Agents have hands, and there are two crates."""
        crate = Body(x=[0, 3]), Shape(half_width=0.6, half_height=0.4), Solid(dynamic=1, density=0.5), Crate()
        return [Archetype("agent", (Weld(),)), Archetype("crate", crate, 2)]

    def singletons(self):
        """What agents want."""
        return [Grab()]


@Grabbing.system(Phase.DRIVE, after=Body)
def grab(
    welds: Write[Weld],
    action: Read[Grab],
    body: Read[Body],
    entities: Read[Entity],
    agents: Rows[Weld],
    crates: Rows[Crate],
    reach: float,
) -> None:
    """The joint is the weld's; this only says when it begins and ends."""
    for i in range(agents.size):
        e = agents[i]
        if not (action.grab[i] and entities.alive[e]):
            let_go(welds, e)
        elif welds.other[e] < 0:
            nearest, least = -1, reach * reach
            for crate in crates:
                x, y = body.x[crate] - body.x[e], body.y[crate] - body.y[e]
                if x * x + y * y <= least:
                    nearest, least = crate, x * x + y * y
            if nearest >= 0:
                hold(welds, body, e, nearest)


GRAB = yard("grab", Grabbing(), agents=2)
