"""Grabbing: an agent welds the nearest crate in reach to itself, and carries it for as long as it wants to."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Shape, Solid, Weld
from outlast.components.joint import hold, let_go
from outlast.components.masks import Idle
from outlast.ecs import (
    Action,
    Archetype,
    Array,
    Bitset,
    Component,
    Entity,
    Module,
    Read,
    Rows,
    Write,
    column,
    kernel,
    number,
)
from outlast.queries import Bodies, nearest


class Crate(Component):
    """What can be grabbed."""


class Grab(Action):
    """1: hold on to a crate, 0: let go."""

    grab: Array = column("i1", "agents", low=0, high=1)


class OutOfReach(Idle):
    """Whose hands are empty, for action masks."""

    grab: Array = column("u1", "agents", high=1)


@dataclass(frozen=True)
class Grabbing(Module):
    """Several agents may hold one crate."""

    reach: float = number(0.5, above=0, unit="metres", about="greatest distance from an agent to a crate")

    def archetypes(self):
        """Agents have hands, and there are two crates."""
        crate = Body(x=[0, 3]), Shape(half_width=0.6, half_height=0.4), Solid(dynamic=1, density=0.5), Crate()
        return [Archetype("agent", (Weld(),)), Archetype("crate", crate, 2)]

    def singletons(self):
        """What agents want, and cannot."""
        return [Grab(), OutOfReach()]


@kernel
def in_hand(welds, bodies, crates, e, reach) -> int:
    """The crate that agent `e` holds, or would if it grabbed now; -1: none. The rule and the mask both ask this."""
    return welds.other[e] if welds.other[e] >= 0 else nearest(bodies, crates, e, reach)


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
        elif welds.other[e] < 0 and in_hand(welds, bodies, crates, e, reach) >= 0:
            hold(welds, body, e, in_hand(welds, bodies, crates, e, reach))


@Grabbing.system(Phase.END)
def mask(
    idle: Write[OutOfReach],
    welds: Read[Weld],
    entities: Read[Entity],
    agents: Rows[Weld],
    crates: Bitset[Crate],
    bodies: Bodies,
    reach: float,
) -> None:
    """Whoever has nothing in hand can neither grab nor let go."""
    for i in range(agents.size):
        e = agents[i]
        idle.grab[i] = not entities.alive[e] or in_hand(welds, bodies, crates, e, reach) < 0


GRAB = yard("grab", Grabbing(), agents=2)
