"""Rows that each agent sees, and rows that its observation shows."""

from typing import Any

from outlast.ecs import Array, Singleton, column, kernel
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH

MASKED, REVEALED, OMNISCIENT = 0, 1, 2
MODES = ("masked", "revealed", "omniscient")


class Sight(Singleton):
    """Visibility bitsets: one bit per entity (see simd), one row per observer. Without cameras, all are set."""

    visible: Array = column("i4", "agents", "blocks")
    mode: Array = column("i4", fill=OMNISCIENT, low=0, high=len(MODES) - 1)  # index into MODES


class ObservationMasks(Singleton, packed=False):
    """The rows of the observations to write: one bit per entity, one row per observer.

    Kept alongside the observations, which outlive an episode: only rows that are filled, or were in the previous
    tick, are written. All others are zero and remain so.
    """

    mask: Array = column("i4", "agents", "blocks")  # the observation's mask is 1
    filled: Array = column("i4", "agents", "blocks")  # the row holds numbers; in masked mode the same as `mask`
    dirty: Array = column("i4", "agents", "blocks")  # the row must be written: it is or was filled


@kernel
def is_set(bitsets: Any, i: int, e: int) -> int:
    """Return the bit of row `e` in bitset number `i`, as 0 or 1."""
    return int((bitsets[i, e >> SIMD_SHIFT] >> (e & SIMD_WIDTH - 1)) & 1)


@kernel
def set_bit(bitsets: Any, i: int, e: int, on: bool) -> None:
    """Set the bit of row `e` in bitset number `i`. In Sight.visible it means that observer `i` sees `e`."""
    bit, word = 1 << (e & SIMD_WIDTH - 1), bitsets[i, e >> SIMD_SHIFT]
    bitsets[i, e >> SIMD_SHIFT] = word | bit if on else word & ~bit
