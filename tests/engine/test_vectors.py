"""Operations with vectors at addresses, and products of matrices, against their plain forms."""

from typing import Any

import numpy as np
import pytest

from outlast.ecs import kernel
from outlast.ecs.kernels import vectors


@pytest.mark.parametrize(("rows", "columns", "depth"), [(1, 16, 1), (8, 32, 5), (21, 112, 40), (3, 48, 0)])
def test_products_of_blocks_and_of_what_is_left_beside_them(rows: int, columns: int, depth: int) -> None:
    """Of the first factor transposed, with a row that is added to each of the result, and a least value."""
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
