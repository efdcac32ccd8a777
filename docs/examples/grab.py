"""Grabbing: an agent welds the nearest crate in reach to itself, and carries it for as long as it wants to."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Shape, Solid, Weld
from outlast.components.joint import hold, let_go
from outlast.ecs import Action, Archetype, Array, Bitset, Component, Entity, Module, Read, Rows, Write, column, number
from outlast.queries import Bodies, nearest


class Crate(Component):
    """What can be grabbed."""


class Grab(Action):
    """1: hold on to a crate, 0: let go."""

    grab: Array = column("i1", "agents", low=0, high=1)


@dataclass(frozen=True)
class Grabbing(Module):
    """Several agents may hold one crate."""

    reach: float = number(0.5, above=0, unit="metres", about="greatest distance from an agent to a crate")

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
    crates: Bitset[Crate],
    bodies: Bodies,
    reach: float,
) -> None:
    """The joint is the weld's; this only says when it begins and ends."""
    for i in range(agents.size):
        e = agents[i]
        if not (action.grab[i] and entities.alive[e]):
            let_go(welds, e)
        elif welds.other[e] < 0:
            crate = nearest(bodies, crates, e, reach)
            if crate >= 0:
                hold(welds, body, e, crate)


GRAB = yard("grab", Grabbing(), agents=2)
