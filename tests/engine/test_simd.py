"""SIMD: vectors against numpy, bitsets against plain lists, compiled and not."""

from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

from outlast.ecs import Entity, Worlds, kernel
from outlast.ecs.kernels import vectors
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, store, to_bits, trailing_zeros
from tests.conftest import COMPILED
from tests.helpers.toy_game import Energy, Food, Place, Walkers, Weather

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
def test_vectors_compute_what_numpy_computes(round_: int) -> None:
    a, b = (RNG.normal(0, 3, SIMD_WIDTH).astype(np.float32) for _ in range(2))
    if round_ % 2:
        a, b = RNG.permutation(SPECIAL), RNG.choice(SPECIAL, SIMD_WIDTH)
    scalar, out = np.float32(RNG.normal()), np.zeros(3, np.int64)
    with np.errstate(all="ignore"):
        arithmetic(a, b, scalar, out)
        expected = in_numpy(a, b, scalar)
    for bits, booleans in zip(out, expected, strict=True):
        assert [bool(bits >> j & 1) for j in range(SIMD_WIDTH)] == booleans.tolist()


@kernel
def positions(alive: Any, start: int, out: Any) -> int:
    pending, count = to_bits(load_flags(alive, start)), 0
    while pending:
        out[count] = start + trailing_zeros(pending)
        pending &= pending - 1
        count += 1
    return count


def test_flags_and_the_bits_of_a_mask() -> None:
    alive = (RNG.random(5 * SIMD_WIDTH) < 0.3).astype(np.uint8) * 200  # any nonzero number is true
    out = np.zeros(SIMD_WIDTH, np.int64)
    for start in range(0, alive.size - SIMD_WIDTH, 7):  # from anywhere
        count = positions(alive, start, out)
        assert out[:count].tolist() == [e for e in range(start, start + SIMD_WIDTH) if alive[e]]
    assert positions(np.zeros(SIMD_WIDTH, np.uint8), 0, out) == 0
    assert positions(np.ones(SIMD_WIDTH, np.uint8), 0, out) == SIMD_WIDTH


def test_bitset_and_row_index_agree_with_rows() -> None:
    layout = Worlds([Walkers(count=21), Food(count=14), Weather()], 1).layout
    for parts in ((Place,), (Energy,), (Place, Energy), (Entity,)):
        rows, bitset, index = layout.rows(*parts), layout.bitset(*parts), layout.row_index(*parts)
        assert bitset.dtype == index.dtype == np.int32
        assert [e for e in range(35) if bitset[e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1] == rows.tolist()
        assert index[rows].tolist() == list(range(len(rows)))
        assert (np.delete(index, rows) == -1).all()


@pytest.mark.skipif(not COMPILED, reason="plain Python raises a ValueError of numpy's")
def test_a_vector_cannot_be_stored_into_a_read_only_array() -> None:
    column = np.zeros(SIMD_WIDTH, np.float32)
    column.flags.writeable = False
    with pytest.raises(TypingError, match="Cannot modify readonly array"):
        copy(column)


@kernel
def copy(column: Any) -> None:
    store(column, 0, load(column, 0))


# ---- products and operations


@pytest.mark.parametrize(("rows", "columns", "depth"), [(1, 16, 1), (8, 32, 5), (21, 112, 40), (3, 48, 0)])
def test_products_of_blocks_and_of_what_is_left_beside_them(rows: int, columns: int, depth: int) -> None:
    rng = np.random.default_rng(rows)
    a, b, start = (rng.normal(size=size).astype(np.float32) for size in ((depth, rows), (depth, columns), columns))
    c, (one, two, three) = np.zeros((rows, columns), np.float32), (each.ctypes.data for each in (a, b, start))
    vectors.product(
        one, 4, 4 * rows, two, 4 * columns, three, 0, c.ctypes.data, 4 * columns, rows, columns, depth, -0.5
    )
    np.testing.assert_allclose(c, np.maximum(a.T @ b + start, -0.5), rtol=1e-5, atol=1e-5)


def test_operations_with_vectors_are_their_plain_forms() -> None:
    """`exponential` is exact to a few units in the last place, down to the smallest normal numbers."""
    rng = np.random.default_rng(1)
    one, other = np.sort(-rng.gamma(1, 20, 16)).astype(np.float32), rng.normal(size=16).astype(np.float32)

    def applied(operation: Any, given: Any) -> Any:
        @kernel
        def to_one(first: int, to: int) -> int:
            vectors.store(to, operation(vectors.load(first)))
            return 0

        @kernel
        def to_both(first: int, second: int, to: int) -> int:
            vectors.store(to, operation(vectors.load(first), vectors.load(second)))
            return 0

        found = np.zeros(16, np.float32)
        (to_one if len(given) == 1 else to_both)(*(each.ctypes.data for each in (*given, found)))
        return found

    one[:3], one[-1] = (-np.inf, -200, -87), 0
    cases: Any = [(vectors.exponential, (one,)), (vectors.head_sums, (other,))]
    cases += [(each, (one, other)) for each in (vectors.larger, vectors.gated, vectors.quotient)]
    for operation, given in cases:
        np.testing.assert_allclose(applied(operation, given), operation(*given), rtol=1e-6)
