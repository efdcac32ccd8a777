"""Hit points, who may take them, and who took them last."""

from typing import Any

import numpy as np

from outlast.ecs import Array, Component, Layout, column, kernel

MOST = 1_000_000  # hit points: the largest value of a number of a mechanic
LARGEST = 2**31 - 1  # hit points that a column holds


class Health(Component):
    """Hit points; at zero or below the entity dies at the next check. A maximum is up to Mortality."""

    points: Array = column("i4", fill=100)
    has_health: Array = column("u1", fill=1)  # 1 in every row that has this component
    damage_type: Array = column("i4", fill=-1)  # of the last loss (see `hurt`)
    source: Array = column("i4", fill=-1)  # the side that caused it, -1: none
    fatal_tick: Array = column("i8", fill=-1)  # the tick that brought the points to 0 or below


class Guard(Component):
    """Immunity: which sides can damage this entity."""

    immune_to: Array = column("i4", fill=-1)  # the side whose attacks do nothing, -1: none
    vulnerable_only_to: Array = column("i4", fill=-1)  # the only side whose attacks do anything, -1: all do


class Death(Component):
    """The death of an agent: filled in the tick it dies, for rewards, statistics and logs."""

    now: Array = column("u1")  # 1 in the tick of death
    damage_type: Array = column("i4", fill=-1)
    source: Array = column("i4", fill=-1)  # the side that killed, -1: none


def full_health(layout: Layout) -> float:
    """Hit points of an agent at the start, the scale of its health; 1 without the mechanic that says it."""
    points: float = layout.numbers("agents").get("health", 1.0)
    return points


@kernel
def immune(guard: Any, e: int, source: int) -> bool:
    """Whether entity `e` takes no damage from `source` (a side, or -1 for damage that no side causes)."""
    return source >= 0 and (
        guard.immune_to[e] == source or (guard.vulnerable_only_to[e] >= 0 and guard.vulnerable_only_to[e] != source)
    )


@kernel
def hurt(health: Any, guard: Any, e: int, amount: int, damage_type: int, source: int, tick: int) -> bool:
    """Take `amount` hit points from `e` unless it is immune; True if it was hurt.

    The recorded source is that of the last loss in the tick that brings the points to 0 or below: who hits an
    entity in a later tick gets no credit (reference rules, section 7, point 6).
    """
    if immune(guard, e, source):
        return False
    before = health.points[e]
    health.points[e] = min(max(np.int64(before) - amount, -LARGEST), LARGEST)
    if before > 0 or health.fatal_tick[e] == tick:
        health.damage_type[e] = damage_type
        health.source[e] = source
    if before > 0 and health.points[e] <= 0:
        health.fatal_tick[e] = tick
    return True
