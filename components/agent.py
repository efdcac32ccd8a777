"""Agents: their sides, and how observations describe them."""

import math

from outlast.ecs import Array, Component, Field, Observation, Singleton, column, exists, kernel

from .body import PLACE, SPEED, SPIN
from .health import full_health


class Side(Component):
    """The side that an agent belongs to: its team, or in free-for-all its own index; -1 for an absent agent."""

    side: Array = column("i4", fill=-1, unit="side")


@kernel
def present(entities: Array, agents: Array) -> int:
    """Return how many agents this episode has, dead or alive. They are the first ones."""
    count = 0
    for e in agents:
        count += exists(entities, e)
    return count


class Sides(Singleton):
    """Whether agents play in teams."""

    teams: Array = column("u1")  # 1: sides are teams, 0: every agent for itself


class SelfView(Observation):
    """The observer's own row; once it is dead, all zeros except id and team. With teams, the team follows the id."""

    own: Array = column(
        "f4",
        "agents",
        fields=(
            Field("id", order=-1),
            Field("health", "hit points", scale=full_health),
            *PLACE,
            Field("angle", "rad", scale=math.pi),
            Field("vx", "m/s", scale=SPEED),
            Field("vy", "m/s", scale=SPEED),
            Field("omega", "rad/s", scale=SPIN),
        ),
    )


class OthersView(Observation):
    """The other agents in order of id, without the observer; rows as in SelfView. Mask: 1 = visible."""

    others: Array = column("f4", "agents", "others", fields="own")
    others_mask: Array = column("f4", "agents", "others", low=0, high=1)
