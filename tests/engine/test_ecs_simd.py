"""Sixteen rows at a time: lanes against numpy, sets of rows against plain lists, compiled and not."""

from typing import Any

import numpy as np
import pytest

from outlast.ecs import Add, Bitset, Entity, Read, RowIndex, Rows, Worlds, kernel
from outlast.ecs.simd import SIMD_WIDTH, load, load_flags, to_bits, trailing_zeros
from tests import toy
from tests.toy import Energy, Food, Place, Walkers, Weather

RNG = np.random.default_rng(0)
SPECIAL = np.array([0, -0.0, 1, -1, np.inf, -np.inf, np.nan, 1e-45, 3e38, 2, 0.1, -0.1, 7, 8, 9, 1e-30], np.float32)


@kernel
def arithmetic(left: Any, right: Any, scalar: Any, out: Any) -> None:
    a, b = load(left, 0), load(right, 0)
    out[0] = to_bits((a + b) * scalar - a * b < b)
    out[1] = to_bits((scalar - a <= b) & ~(abs(a) * abs(b) >= scalar))
    out[2] = to_bits((a > scalar) | (scalar + b > a * scalar))


def in_numpy(a: Any, b: Any, scalar: Any) -> list[np.ndarray]:
    return [
        (a + b) * scalar - a * b < b,
        (scalar - a <= b) & ~(abs(a) * abs(b) >= scalar),
        (a > scalar) | (scalar + b > a * scalar),
    ]


@pytest.mark.parametrize("round_", range(20))
def test_lanes_compute_what_numpy_computes(round_: int) -> None:
    """Each lane rounded as if alone; infinities, NaN, denormals and signed zeros among them."""
    a, b = (RNG.normal(0, 3, SIMD_WIDTH).astype(np.float32) for _ in range(2))
    if round_ % 2:
        a, b = RNG.permutation(SPECIAL), RNG.choice(SPECIAL, SIMD_WIDTH)
    scalar, out = np.float32(RNG.normal()), np.zeros(3, np.int64)
    with np.errstate(all="ignore"):
        arithmetic(a, b, scalar, out)
        expected = in_numpy(a, b, scalar)
    for word, truths in zip(out, expected, strict=True):
        assert [bool(word >> j & 1) for j in range(SIMD_WIDTH)] == truths.tolist()


@kernel
def positions(alive: Any, start: int, out: Any) -> int:
    left, count = to_bits(load_flags(alive, start)), 0
    while left:
        out[count] = start + trailing_zeros(left)
        left &= left - 1
        count += 1
    return count


def test_flags_and_the_bits_of_a_set() -> None:
    alive = (RNG.random(5 * SIMD_WIDTH) < 0.3).astype(np.uint8) * 200  # any nonzero number is true
    out = np.zeros(SIMD_WIDTH, np.int64)
    for start in range(0, alive.size - SIMD_WIDTH, 7):  # from anywhere
        count = positions(alive, start, out)
        assert out[:count].tolist() == [e for e in range(start, start + SIMD_WIDTH) if alive[e]]
    assert positions(np.zeros(SIMD_WIDTH, np.uint8), 0, out) == 0
    assert positions(np.ones(SIMD_WIDTH, np.uint8), 0, out) == SIMD_WIDTH


def test_bits_and_rank_say_what_rows_says() -> None:
    """In a scenario of more than sixteen rows, of which some in the middle do not belong."""
    layout = Worlds([Walkers(count=21), Food(count=14), Weather()], 1).layout
    for parts in ((Place,), (Energy,), (Place, Energy), (Entity,)):
        rows, words, rank = layout.rows(*parts), layout.bitset(*parts), layout.row_index(*parts)
        assert words.dtype == rank.dtype == np.int32
        assert [e for e in range(35) if words[e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1] == rows.tolist()
        assert rank[rows].tolist() == list(range(len(rows)))
        assert (np.delete(rank, rows) == -1).all()


class Feast(toy.Toy):
    """Everybody gets a thousand, found by sets of rows."""


@Feast.system(toy.Phase.FEED)
def feed(
    energy: Add[Energy], entities: Read[Entity], rows: Rows[Energy], eaters: Bitset[Energy], index: RowIndex[Energy]
) -> None:
    for g in range(eaters.size):
        left = to_bits(load_flags(entities.alive, SIMD_WIDTH * g)) & eaters[g]
        while left:
            e = SIMD_WIDTH * g + trailing_zeros(left)
            left &= left - 1
            energy.left[e] += np.int32(1000 * (rows[index[e]] == e))


def test_a_system_can_go_through_sets_of_rows() -> None:
    game = (Walkers(count=21), Food(count=14), Weather())
    plain, fed = toy.run(toy.make(*game), toy.STEP), toy.run(toy.make(*game, Feast()), toy.STEP)
    gained = fed[Energy].left - plain[Energy].left
    assert (gained[:, fed.span("walker")] == 1000).all()
    assert (gained[:, fed.span("food")] == 0).all()
