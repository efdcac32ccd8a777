"""Hit points, who may take them, and who did."""

from typing import Any

import numpy as np

from outlast.ecs import Array, Component, column, kernel

MOST = 1_000_000  # hit points: the most that a number of a mechanic may say
LARGEST = 2**31 - 1  # hit points that a column holds


class Health(Component):
    """Hit points; at zero or below the entity dies at the next check. A maximum is up to Mortality."""

    points: Array = column("i4", fill=100)
    mortal: Array = column("u1", fill=1)  # 1: this row has health at all
    cause: Array = column("i4", fill=-1)  # number of the cause of the last loss (see `hurt`)
    source: Array = column("i4", fill=-1)  # the side that did it, -1: nobody
    doomed: Array = column("i8", fill=-1)  # the tick that brought the points to 0 or below


class Guard(Component):
    """Immunity: from whose hand this entity takes harm. Written by sides and boxes."""

    ignores: Array = column("i4", fill=-1)  # the side whose attacks do nothing, -1: none
    heeds: Array = column("i4", fill=-1)  # the only side whose attacks do anything, -1: every side's


class Death(Component):
    """The death of an agent: filled in the tick it dies, for rewards, statistics and logs."""

    now: Array = column("u1")  # 1 in the tick of death
    cause: Array = column("i4", fill=-1)
    source: Array = column("i4", fill=-1)  # the side that killed, -1: nobody


@kernel
def immune(guard: Any, e: int, source: int) -> bool:
    """Whether entity `e` takes no harm from `source` (a side, or -1 for harm without an author)."""
    return source >= 0 and (guard.ignores[e] == source or (guard.heeds[e] >= 0 and guard.heeds[e] != source))


@kernel
def hurt(health: Any, guard: Any, e: int, amount: int, cause: int, source: int, tick: int) -> bool:
    """Take `amount` hit points from `e` unless it is immune; True if it was hurt.

    The recorded cause is that of the last loss in the tick that brings the points to 0 or below: who hits an
    entity that is already doomed in a later tick gets no credit (reference rules, section 7, point 6).
    """
    if immune(guard, e, source):
        return False
    before = health.points[e]
    health.points[e] = min(max(np.int64(before) - amount, -LARGEST), LARGEST)
    if before > 0 or health.doomed[e] == tick:
        health.cause[e] = cause
        health.source[e] = source
    if before > 0 and health.points[e] <= 0:
        health.doomed[e] = tick
    return True
