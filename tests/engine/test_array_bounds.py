"""Memory behind the end of an array: a user's kernel gets there by no index, however the array was made."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba import types
from numba.core.registry import cpu_target
from numba.core.types import ArrayFlags

from outlast.components.sight import is_set
from outlast.ecs import DeclarationError, Entity, Rows, Worlds, Write, kernel
from outlast.ecs.checks.source_check import UNCHECKED
from outlast.ecs.kernels.array_types import CheckedColumn
from outlast.ecs.kernels.simd import load, load_flags, store, store_bytes, to_bits
from tests.conftest import compiled_only
from tests.helpers.toy_game import RESET, STEP, Place, Walkers, run, system_of

FAR = 300
USED = is_set, load, load_flags, to_bits  # by expressions
pytestmark = pytest.mark.usefixtures("untried")


def worlds_with(reach: Callable[..., Any]) -> Worlds:
    """Worlds with a system that calls `reach` with the tables of Place and Entity and an index out of range."""
    reach = kernel(reach)

    def act(place: Write[Place], entities: Write[Entity], rows: Rows[Place]) -> None:
        place.x[0] += reach(place, entities, FAR + rows[0])

    return Worlds([Walkers(), system_of(act)], 50)


@kernel
def part(place: Any) -> Any:
    return place.trail[1:]


def reaching(text: Any) -> Any:
    """A function that returns the value of an expression, unless it is one already."""
    lambda_ = f"lambda place, entities, far: {text}"
    return eval(compile(lambda_, __file__, "eval"), globals()) if isinstance(text, str) else text


@compiled_only
@pytest.mark.parametrize("name", [name for name in dir(np.ndarray) if not name.startswith("_")])
def test_each_attribute_of_a_column_is_checked_or_refused(name: str) -> None:
    """All arrays among those that numba knows are columns, whose indices are checked."""
    cpu_target.typing_context.refresh()
    kind = cpu_target.typing_context.resolve_getattr(CheckedColumn(types.float32, 2), name)
    safe = types.Number, types.BaseTuple, types.BoundFunction, types.DType, ArrayFlags, CheckedColumn
    assert kind is None or isinstance(kind, safe) == (name not in UNCHECKED)


@pytest.mark.by_day(4)
@pytest.mark.parametrize(
    "reach",
    [
        "place.x[1:][1:][far]",
        "place.trail[0][far]",
        "place.trail[:, far][0]",
        "part(place)[0, far]",
        "part(place)[-far, 0]",
        "place.trail.ravel()[far]",
        "place.trail.reshape(6)[far]",
        "place.x.view(np.int32)[far]",
        "place.trail.T[0, far]",
        "np.expand_dims(place.x, 0)[0, far]",
        "place.x[np.array([far])][0]",
        "place.x[np.ones(far, np.bool_)][0]",
        "np.take(place.x, far)",
        "np.zeros(3)[far]",
        "(1.0, 2.0)[far]",
        "is_set(place.trail, far, 0)",
        "is_set(np.zeros((3, 2), np.int16), far, 0)",
        "is_set(np.zeros((3, 2), np.int16)[::2], far, 0)",
    ],
)
def test_an_index_behind_the_end_raises_however_the_array_was_made(reach: Any) -> None:
    worlds = run(worlds_with(reaching(reach)), RESET)
    with pytest.raises(IndexError):
        run(worlds, STEP)


def stores(place: Any, entities: Any, far: int) -> int:
    store(place.x, far, load(place.x, 0))
    return 0


def stores_at_the_end(place: Any, entities: Any, far: int) -> int:
    store(place.x, place.x.size - 1, load(place.x, 0))
    return 0


def stores_bytes(place: Any, entities: Any, far: int) -> int:
    store_bytes(entities.alive, -1, load(place.x, 0), 3)
    return 0


@compiled_only
@pytest.mark.by_day(2)
@pytest.mark.parametrize(
    "reach",
    [
        "to_bits(load(place.x, far) > np.float32(0))",
        "to_bits(load_flags(entities.alive, -far))",
        stores,
        stores_at_the_end,
        stores_bytes,
    ],
)
def test_a_vector_behind_the_end_raises(reach: Any) -> None:
    worlds = run(worlds_with(reaching(reach)), RESET)
    with pytest.raises(IndexError, match="a vector is out of bounds of its array"):
        run(worlds, STEP)


@compiled_only
def test_a_vector_has_the_type_of_its_column() -> None:
    with pytest.raises(DeclarationError, match=r"local\.act .* load\(.*array\(u?int"):
        run(worlds_with(reaching("to_bits(load(entities.identity, 0) > np.float32(0))")), RESET)
