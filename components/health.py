"""Hit points, immunity, and the source of the last damage."""

from typing import Annotated, Any, TypeAlias

import numpy as np

from outlast.ecs import Array, Component, Event, Label, Layout, column, emit, index_unit, kernel

MOST = 1_000_000  # hit points: the largest value that a number of a mechanic can have
LARGEST = 2**31 - 1  # hit points: the largest value that a column can hold

DamageType: TypeAlias = Annotated[int, Label("damage_type")]
"""A parameter of systems: the number of the mechanic's `damage_type`. Deaths are counted by damage type."""

index_unit("damage type", "damage_types")


class Guard(Component):
    """Immunity to the damage of sides."""

    immune_to: Array = column("i4", fill=-1)  # the side whose attacks have no effect, -1: none
    vulnerable_only_to: Array = column("i4", fill=-1)  # the only side whose attacks have an effect, -1: all have


class Health(Component):
    """Hit points. At zero or below, the entity dies at the next check. Mortality may set a maximum."""

    requires = (Guard,)

    points: Array = column("i4", fill=100)
    has_health: Array = column("u1", fill=1)  # 1 in every row that has this component
    damage_type: Array = column("i4", fill=-1, unit="damage type")  # damage type of the last loss (see `hurt`)
    source: Array = column("i4", fill=-1, unit="side")  # the side that caused it, -1: none
    fatal_tick: Array = column("i8", fill=-1)  # the tick that brought the points to 0 or below


class Died(Component):
    """The cause of an agent's death, kept until the episode ends. Systems that act on deaths read the event `Death`."""

    now: Array = column("u1")  # 1 in the tick of death
    damage_type: Array = column("i4", fill=-1, unit="damage type")
    source: Array = column("i4", fill=-1, unit="side")  # the side that killed, -1: none


class Hit(Event, capacity="hits"):
    """An entity took damage, from any caller of `hurt`."""

    agent: Array = column("i4", unit="entity")  # the agent that caused it, -1: none
    target: Array = column("i4", unit="entity")
    amount: Array = column("i4", unit="hit points")
    damage_type: Array = column("i4", unit="damage type")
    side: Array = column("i4", unit="side")  # the side that caused it, -1: none


class Death(Event, capacity=Died, who="by", whom="agent"):
    """An agent died."""

    agent: Array = column("i4", unit="entity")  # the agent that died
    by: Array = column("i4", unit="entity")  # the agent whose hit in this tick killed, -1: none
    damage_type: Array = column("i4", unit="damage type")
    side: Array = column("i4", unit="side")  # the side that killed, -1: none


def full_health(layout: Layout) -> float:
    """Return an agent's hit points at the start, the scale of its health; 1 without a mechanic that sets them."""
    points: float = layout.numbers("agents").get("health", 1.0)
    return points


def can_hurt(layout: Layout) -> bool:
    """Return whether some mechanic does damage, so that hit points matter."""
    return bool(layout.labels["damage_type"])


@kernel
def immune(guard: Any, e: int, source: int) -> bool:
    """Return whether entity `e` takes no damage from `source` (a side, or -1 for damage that no side causes)."""
    return source >= 0 and (
        guard.immune_to[e] == source or (guard.vulnerable_only_to[e] >= 0 and guard.vulnerable_only_to[e] != source)
    )


@kernel
def hurt(
    health: Any, guard: Any, hits: Any, e: int, amount: int, damage_type: int, source: int, tick: int, agent: int = -1
) -> bool:
    """Take `amount` hit points from `e` unless it is immune. If it was hurt, emit a `Hit` and return True.

    An amount of 0 is not a hit, and gives no credit.

    The recorded source is that of the last loss in the tick that brings the points to 0 or below: hits in later ticks
    get no credit (reference rules, section 7, point 6).

    Args:
        health: The table of Health, to write.
        guard: The table of Guard.
        hits: The table of Hit, to write. A mechanic that calls this function adds the number of possible calls per tick
            to the dimension "hits", and returns Hit() among its singletons.
        e: Row of the entity.
        amount: Hit points.
        damage_type: Number of the damage type.
        source: The side that does the damage, -1: none.
        tick: Tick of the episode.
        agent: Row of the agent that does the damage, -1: none.
    """
    if amount == 0 or immune(guard, e, source):
        return False
    before = health.points[e]
    health.points[e] = min(max(np.int64(before) - amount, -LARGEST), LARGEST)
    if before > 0 or health.fatal_tick[e] == tick:
        health.damage_type[e] = damage_type
        health.source[e] = source
    if before > 0 and health.points[e] <= 0:
        health.fatal_tick[e] = tick
    k = emit(hits)
    hits.agent[k], hits.target[k], hits.amount[k] = agent, e, amount
    hits.damage_type[k], hits.side[k] = damage_type, source
    return True


@kernel
def fatal_agent(health: Any, hits: Any, e: int, tick: int) -> int:
    """Return the row of the agent whose hit in this tick brought `e` to 0 or below (credit as in `hurt`); -1: none."""
    if health.fatal_tick[e] == tick:
        for k in range(hits.count[0] - 1, -1, -1):
            if hits.target[k] == e:
                return int(hits.agent[k])
    return -1
