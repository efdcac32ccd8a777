"""What each agent sees, and what its observation tells of."""

from typing import Any

from outlast.ecs import Array, Singleton, column, kernel
from outlast.ecs.simd import SIMD_SHIFT, SIMD_WIDTH

MASKED, REVEALED, OMNISCIENT = 0, 1, 2
MODES = ("masked", "revealed", "omniscient")


class Sight(Singleton):
    """Who sees whom: sets of rows (see ecs.simd) by observer. Written by cameras; without, all see everything."""

    seen: Array = column("i4", "agents", "blocks")
    mode: Array = column("i4", fill=OMNISCIENT)  # index into MODES


class Told(Singleton, packed=False):
    """Of whom the observations tell: sets of rows by observer. Written by agents.look.

    Lies beside the observations, which outlive an episode: only entries that tell of somebody, or did so in the tick
    before, are written anew. All others are zero and stay so.
    """

    masks: Array = column("i4", "agents", "blocks")  # their mask is 1
    filled: Array = column("i4", "agents", "blocks")  # their entry is filled, which in masked mode is the same
    stale: Array = column("i4", "agents", "blocks")  # their entry must be written: it is filled, or was


@kernel
def told(sets: Any, i: int, e: int) -> int:
    """Whether row `e` is in the set of observer number `i`, as 0 or 1."""
    return int((sets[i, e >> SIMD_SHIFT] >> (e & SIMD_WIDTH - 1)) & 1)
