"""Masked rows of observations, such as `heals` with `heals_mask`: written here for all mechanics that have some."""

from typing import Any

from outlast.components.sight import is_set
from outlast.ecs import Array, kernel
from outlast.ecs.kernels.simd import trailing_zeros

from .geometry.blocks import block_span, first_row

FEW = 3  # if a kind has no more blocks than this, a branch for each is faster
WORD = 64  # how many blocks are looked at together


@kernel
def write_rows(
    rows: Array,
    row_masks: Array,
    masks: Array,
    members: Array,
    index: Array,
    fill: Any,
    tables: Any,
    skip_self: bool = False,
) -> None:
    """Write the dirty rows of the entities `members`, and their masks, for every observer.

    Args:
        rows: f4 (agents, entities, features), a column of the observation.
        row_masks: f4 (agents, entities), its mask.
        masks: The table of ObservationMasks.
        members: Bitset of the entities.
        index: RowIndex of the entities: their index in `rows`.
        fill: Kernel (row, e, filled, tables) that writes all features of entity `e` to `row`, zeros if not `filled`.
        tables: Tuple of what `fill` needs.
        skip_self: Whether the entities are the observers themselves, so that each only has rows of the others.
    """
    first, last = block_span(members)
    for i in range(rows.shape[0]):
        if last - first <= FEW:
            for b in range(first, last):
                write_block(rows, row_masks, masks, members, i, b, index, fill, tables, skip_self)
            continue
        for start in range(first, last, WORD):
            some = 0  # which blocks have dirty rows, found without a branch, which would often be mispredicted
            for b in range(start, min(start + WORD, last)):
                some |= int(masks.dirty[i, b] & members[b] != 0) << (b - start)
            while some:
                b = start + trailing_zeros(some)
                some &= some - 1
                write_block(rows, row_masks, masks, members, i, b, index, fill, tables, skip_self)


@kernel
def write_block(
    rows: Array,
    row_masks: Array,
    masks: Array,
    members: Array,
    i: int,
    b: int,
    index: Array,
    fill: Any,
    tables: Any,
    skip_self: bool,
) -> None:
    """Write the dirty rows in block `b` for observer `i`. For the other arguments see `write_rows`."""
    pending = masks.dirty[i, b] & members[b]
    while pending:
        e = first_row(b, pending)
        pending &= pending - 1
        k = index[e]
        if skip_self:
            if k == i:
                continue
            k -= k > i
        row_masks[i, k] = is_set(masks.mask, i, e)
        fill(rows[i, k], e, is_set(masks.filled, i, e) != 0, tables)
