"""A turret: it turns to the nearest agent in sight, and a crate is cover."""

import math
from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Look, Phase, Reward, Shape, Side, Solid
from outlast.components.body import face
from outlast.ecs import Archetype, Array, Bitset, Component, Module, Rows, Write, column, number
from outlast.queries import Bodies, distance, line_of_sight


class Turret(Component):
    """Whom it aims at."""

    target: Array = column("i4", fill=-1, unit="entity")


@dataclass(frozen=True)
class Turrets(Module):
    """Whoever is aimed at pays."""

    reach: float = number(8.0, above=0, unit="metres", about="how far it sees")
    price: float = number(0.1, unit="reward per tick", about="what it costs to be aimed at")

    def archetypes(self):
        """A turret in the middle, and a crate to hide behind."""
        turret = Body(), Shape(half_width=0.4, half_height=0.2), Solid(), Turret()
        crate = Body(x=-2.0), Shape(half_width=0.3, half_height=0.8), Solid(dynamic=1)
        return [Archetype("turret", turret, 1), Archetype("crate", crate, 1)]

    def singletons(self):
        """What is paid."""
        return [Reward()]

    def looks(self):
        """A line to the target."""
        return {"turret": Look(line_to=Turret.target)}


@Turrets.system(Phase.REWARD)
def aim(
    body: Write[Body],
    turret: Write[Turret],
    reward: Write[Reward],
    agents: Rows[Side],
    turrets: Rows[Turret],
    solids: Bitset[Solid],
    bodies: Bodies,
    reach: float,
    price: float,
) -> None:
    """Line of sight goes from centre to outline, past nothing solid."""
    for e in turrets:
        best, turret.target[e] = reach, -1
        for i in range(agents.size):
            o = agents[i]
            if distance(bodies, e, o) <= best and line_of_sight(bodies, solids, e, o):
                best, turret.target[e] = distance(bodies, e, o), o
        for i in range(agents.size):
            if agents[i] == turret.target[e]:
                reward.reward[i] -= price
                face(body, e, math.atan2(body.y[agents[i]] - body.y[e], body.x[agents[i]] - body.x[e]))


TURRET = yard("turret", Turrets(), agents=2).without("rewards")
