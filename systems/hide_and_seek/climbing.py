"""Climbing: an agent that runs up a ramp is aloft for a while: it passes over walls and things, and sees over them.

The game is two-dimensional. The published game has walls that a ramp reaches to the top of, and agents that fall from
them; here an agent is either on the ground or aloft, and comes down where it has room.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Filter, Look, Phase, SelfView, Shape, Side, Sight, Solid
from outlast.components.contact import ALL
from outlast.components.hide_and_seek import Aloft, Climbed, Movable, Ramp
from outlast.components.limits import TICKS
from outlast.components.sight import set_bit
from outlast.ecs import (
    Archetype,
    Bitset,
    Entity,
    Event,
    Field,
    Layout,
    Module,
    NumberError,
    Read,
    RowIndex,
    Rows,
    Write,
    emit,
    kernel,
    number,
    of,
)
from outlast.systems.geometry.bodies import Bodies
from outlast.systems.geometry.points import to_local
from outlast.systems.geometry.queries import line_of_sight, within
from outlast.systems.observation_rows import more_fields

AGENTS = 2  # their layer; walls and things are in layer 1, which have no filter of their own
START = np.float32(0.2)  # metres before the low edge of a ramp where an agent begins to climb, beyond its own radius


@dataclass(frozen=True)
class Climbing(Module):
    """An agent that moves onto the low edge of a ramp, towards its high edge, is aloft from then on.

    It comes down `ticks` ticks after it has left the ramp, or later, as long as it is above a wall or a thing. Agents
    that are aloft touch only agents. They see over walls and things, and are seen over them.
    """

    ticks: int = number(
        12,
        low=0,
        high=TICKS,
        per_agent=True,
        unit="ticks",
        about="how long an agent stays aloft behind a ramp; 0: never",
    )

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Aloft(), Filter(layer=AGENTS)))]

    def singletons(self) -> Iterable[Event]:
        return [Climbed()]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": ALOFT}

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"aloft": (0, self.ticks)}}

    def looks(self) -> Mapping[str, Look]:
        """Return looks: a ring around agents aloft."""
        return {"agent": Look(ring=Aloft.ticks)}

    def check(self, layout: Layout) -> None:
        if layout.numbers("cameras").get("cone", "sector") != "sector":
            raise NumberError("climbing requires vision sectors: set cameras_cone='sector'")


@kernel
def climbs(body: Any, shape: Any, e: int, ramp: int) -> bool:
    """Return whether agent `e` is at the low edge of a ramp, or on it, and moves up."""
    x, y = to_local(body.x[e] - body.x[ramp], body.y[e] - body.y[ramp], body.cosine[ramp], body.sine[ramp])
    vx, vy = body.vx[e] - body.vx[ramp], body.vy[e] - body.vy[ramp]
    up, _ = to_local(vx, vy, body.cosine[ramp], body.sine[ramp])
    edge = -shape.half_width[ramp]
    return bool(up > 0 and abs(y) < shape.half_height[ramp] and edge - shape.radius[e] - START < x < edge + START)


@Climbing.system(Phase.DRIVE, after=(Body, "preparation"), before="handling")
def climb(
    aloft: Write[Aloft],
    filters: Write[Filter],
    events: Write[Climbed],
    body: Read[Body],
    shape: Read[Shape],
    entities: Read[Entity],
    agents: Rows[Aloft],
    ramps: Rows[Ramp],
    solids: Bitset[Solid],
    agent: RowIndex[Aloft],
    ramp: RowIndex[Ramp],
    bodies: Bodies,
    ticks: int,
) -> None:
    """Lift agents up, and bring them down where they have room."""
    for e in agents:
        left, most, above, on_ramp = aloft.ticks[e], of(ticks, e), False, False
        if left > 0:
            for k in range(within(bodies, solids, e, 0)):
                above |= agent[bodies.rows[k]] < 0
                on_ramp |= ramp[bodies.rows[k]] >= 0
            left = most if on_ramp else left - 1 if left > 1 or not above else 1
        elif entities.alive[e] and most > 0:
            for each in ramps:
                if left == 0 and entities.alive[each] and climbs(body, shape, e, each):
                    left, k = most, emit(events)
                    events.agent[k], events.ramp[k] = e, each
        aloft.ticks[e] = left
        filters.hits[e] = AGENTS if left > 0 else ALL


@Climbing.system(Phase.SEE, after="cameras")
def see_over(
    sight: Write[Sight],
    body: Read[Body],
    aloft: Read[Aloft],
    entities: Read[Entity],
    agents: Rows[Aloft],
    things: Rows[Movable],
    high: Bitset[Aloft],
    bodies: Bodies,
    cameras_fov: float,
    cameras_depth: float,
) -> None:
    """Make agents aloft see, and be seen, past everything but other agents."""
    for i in range(agents.size):
        me = agents[i]
        if not entities.alive[me]:
            continue
        for e in agents:
            if e != me and (aloft.ticks[me] > 0 or aloft.ticks[e] > 0):
                look(sight, body, entities, high, bodies, i, me, e, of(cameras_fov, me), of(cameras_depth, me))
        if aloft.ticks[me] > 0:
            for e in things:
                look(sight, body, entities, high, bodies, i, me, e, of(cameras_fov, me), of(cameras_depth, me))


@kernel
def look(
    sight: Any, body: Any, entities: Any, high: Any, bodies: Any, i: int, me: int, e: int, fov: Any, depth: Any
) -> None:
    """Show `e` to agent `me`, number `i`, if it is alive, in its vision cone, and not behind another agent."""
    x, y = to_local(body.x[e] - body.x[me], body.y[e] - body.y[me], body.cosine[me], body.sine[me])
    far = math.sqrt(x * x + y * y)
    if entities.alive[e] and far <= depth and x >= far * math.cos(fov / 2) and line_of_sight(bodies, high, me, e):
        set_bit(sight.visible, i, e, True)


@kernel
def above(i: int, e: int, aloft: Read[Aloft]) -> int:
    """Return the remaining ticks of an agent aloft."""
    return int(aloft.ticks[e])


ALOFT = more_fields(Climbing, SelfView, "own", Side, aloft=above)
