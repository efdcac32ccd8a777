"""Agents: their sides, and their observations."""

import functools
import math
from itertools import pairwise

import numpy as np

from outlast.ecs import (
    Array,
    Component,
    Field,
    MemoryLayout,
    Observation,
    Singleton,
    column,
    exists,
    index_unit,
    kernel,
)
from outlast.ecs.declarations.roles import NEVER

from .body import PLACE, SPEED, SPIN

index_unit("side", "sides")


class Side(Component):
    """The side of an agent: its team, or in free-for-all its own index; -1 for an absent agent."""

    side: Array = column("i4", fill=-1, unit="side")


@kernel
def present(entities: Array, agents: Array) -> int:
    """Return the number of agents of this episode, dead or alive. They are the first ones."""
    count = 0
    for e in agents:
        count += exists(entities, e)
    return count


class Sides(Singleton):
    """A mark of worlds in which agents play in teams."""

    teams: Array = column("u1")  # 1: sides are teams, 0: every agent for itself


class SelfView(Observation):
    """The observer's own row; once it is dead, all zeros except id and team. With teams, the team follows the id."""

    own: Array = column(
        "f4",
        "agents",
        fields=(
            Field("id", order=-3),
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


@functools.lru_cache(maxsize=8)
def side_names(layout: MemoryLayout) -> tuple[str, ...]:
    """Return the names of the sides, by number: "agent 0" without teams. A team can have the name of its own role.

    A role is a team's own if in all worlds all its members have it, and no other agents.
    """
    teams = len(layout.groups())
    plain = tuple(f"{'team' if teams else 'agent'} {k}" for k in range(teams or layout.dims.get("sides", 0)))
    if not teams or layout.roles is None or layout.roles.drawn != NEVER:
        return plain
    counts, owned = layout.agent_counts, [set[int]() for _ in plain]
    for count, roles in zip(counts, layout.roles.of_counts(counts[0], counts[-1]), strict=True):
        for sizes in layout.groupings(count):
            for team, (first, last) in enumerate(pairwise(np.minimum(np.cumsum([0, *sizes]), count))):
                own = {*roles[first:last]}
                others = {*roles[:first], *roles[last:count]}
                owned[team] |= own if len(own) < 2 and not own & others else {-1}
    names = layout.roles.names
    return tuple(names[min(own)] if len(own) == 1 and own != {-1} else name for own, name in zip(owned, plain))
