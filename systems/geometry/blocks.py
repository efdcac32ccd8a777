"""Bitsets of rows by block: block `b` is the rows 16 b to 16 b + 15, and bit j of its bitset is row 16 b + j.

pending = bodies.living[b]
while pending:
    e = first_row(b, pending)
    pending &= pending - 1
"""

from outlast.ecs import Array, kernel
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH, load_flags, to_bits, trailing_zeros


@kernel
def first_row(b: int, bits: int) -> int:
    """Return the first row in a bitset of block `b`, which must not be empty."""
    return int(SIMD_WIDTH * b + trailing_zeros(bits))


@kernel
def without_row(bits: int, b: int, e: int) -> int:
    """Return a bitset of block `b` without row `e`."""
    return bits & ~(1 << (e & SIMD_WIDTH - 1)) if e >> SIMD_SHIFT == b else bits


@kernel
def append_rows(rows: Array, found: int, b: int, bits: int) -> int:
    """Append the rows in a bitset of block `b` to a list of `found` rows. Return its new length."""
    while bits:
        rows[found] = first_row(b, bits)
        bits &= bits - 1
        found += 1
    return found


@kernel
def block_span(members: Array) -> tuple[int, int]:
    """Return the range of blocks that have members: from the first up to, but not including, the second."""
    first, last = members.size, 0
    for b in range(members.size):
        if members[b]:
            first, last = min(first, b), b + 1
    return first, last


@kernel
def alive_bits(entities: Array, members: Array, b: int) -> int:
    """Return the bitset of living `members` (bitsets by block) in block `b`."""
    return int(to_bits(load_flags(entities.alive, SIMD_WIDTH * b)) & members[b])
