"""Memory behind the end of an array: a user's kernel gets there by no index and by no function of numpy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import types
from numba.core.registry import cpu_target
from numba.core.types import ArrayFlags
from numpy.lib.stride_tricks import as_strided

from outlast.components.sight import is_set
from outlast.ecs import DeclarationError, Entity, Rows, Worlds, Write, kernel
from outlast.ecs.kernels.array_check import UNCHECKED_TYPES
from outlast.ecs.kernels.array_types import CheckedColumn
from outlast.ecs.kernels.jit import entry_point
from outlast.ecs.kernels.simd import load, load_flags, store, store_bytes, to_bits
from tests.conftest import COMPILED
from tests.helpers.toy_game import RESET, STEP, Place, Walkers, run, system_of

HOME, FAR, TABLE = Path(__file__).name, 300, np.arange(4.0)
USED = as_strided, is_set, load, load_flags, to_bits  # by expressions
pytestmark = pytest.mark.usefixtures("untried")
compiled_only = pytest.mark.skipif(not COMPILED, reason="about machine code")


class Pair(NamedTuple):
    first: Any
    second: int


def worlds_with(reach: Callable[..., Any]) -> Worlds:
    """Worlds with a system that calls `reach` with the tables of Place and Entity and an index out of range."""
    reach = kernel(reach)

    def act(place: Write[Place], entities: Write[Entity], rows: Rows[Place]) -> None:
        place.x[0] += reach(place, entities, FAR + rows[0])

    return Worlds([Walkers(), system_of(act)], 50)


@kernel
def flat_of(place: Any) -> Any:
    return place.x.flat


@entry_point  # a function that the user compiles by numba
def flat_element(column: Any, far: int) -> Any:
    return column.flat[far]


@kernel
def part(place: Any) -> Any:
    return place.trail[1:]


def adds(place: Any, entities: Any, far: int) -> int:
    place.x[:2] += np.ones(1, np.float32)
    return 0


def sets(place: Any, entities: Any, far: int) -> int:
    place.x.flat[far] = 1
    return 0


def walks(place: Any, entities: Any, far: int) -> float:
    total = 0.0
    for x in place.x.flat:
        total += x
    return total


def reaching(text: Any) -> Any:
    """A function that returns the value of an expression, unless it is one already."""
    lambda_ = f"lambda place, entities, far: {text}"
    return eval(compile(lambda_, __file__, "eval"), globals()) if isinstance(text, str) else text


@compiled_only
@pytest.mark.parametrize(
    ("reach", "words"),
    [
        ("place.x.flat[far]", r"takes \.flat of an array, whose indices nothing checks; ind"),
        ("np.zeros(3).flat[far]", r"takes \.flat"),
        ("TABLE.flat[far]", r"takes \.flat"),
        ("Pair(place.x, 3).first.flat[far]", r"takes \.flat"),
        ("[place.x, place.x][far % 2].flat[far]", r"takes \.flat"),
        ("flat_of(place)[far]", r"takes \.flat"),
        ("flat_element(place.x, far)", r"takes \.flat"),
        (sets, r"takes \.flat"),
        (walks, r"takes \.flat"),
        ("place.x.ctypes.data", r"takes \.ctypes of an array, an address that nothing checks"),
        ("as_strided(place.x, (far,), (4,))[far]", r"calls as_strided, whose shape"),
        ("np.delete(place.x, np.array([far])).size", r"calls np\.delete, whose indices noth"),
        ("np.add(place.x, place.x, np.zeros(far))[0]", r"lets add write into an array, whos"),
        ("np.sqrt(place.x, np.zeros(far))[0]", r"lets sqrt write .* write a\[\.\.\.\] = sqrt"),
        ("np.outer(place.x, place.x, np.zeros((far, far)))[0, 0]", r"lets outer write into"),
        (adds, r"changes an array by another one, whose shape nothing checks \(add\); write a\[\.\.\.\] = a \+ b"),
    ],
)
def test_what_numba_does_not_check_is_refused(reach: Any, words: str) -> None:
    """With the line; and without the advice to run it as Python, for which numpy would check it."""
    with pytest.raises(DeclarationError, match=rf"^local\.act \({HOME}, line .*\) {words}") as caught:
        run(worlds_with(reaching(reach)), RESET)
    assert "interpret" not in str(caught.value)


@pytest.mark.parametrize("name", [name for name in dir(np.ndarray) if not name.startswith("_")])
def test_each_attribute_of_a_column_is_checked_or_refused(name: str) -> None:
    """All arrays among those that numba knows are columns, whose indices are checked."""
    cpu_target.typing_context.refresh()
    kind = cpu_target.typing_context.resolve_getattr(CheckedColumn(types.float32, 2), name)
    safe = types.Number, types.BaseTuple, types.BoundFunction, types.DType, ArrayFlags, CheckedColumn
    assert kind is None or isinstance(kind, (*safe, *UNCHECKED_TYPES))
    assert (type(kind) in UNCHECKED_TYPES) == (name in ("ctypes", "flat"))


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
    """Also in functions of outlast that get an array of the system's own."""
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
