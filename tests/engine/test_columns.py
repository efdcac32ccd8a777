"""Arrays whose indices are taken as they are: outlast's own kernels never count from the end of one."""

from operator import setitem
from typing import Any

import numpy as np
import pytest
from numba import types
from numba.core.errors import NumbaError

from outlast import make_vec
from outlast.ecs import Read, Rows, Worlds
from outlast.ecs.compilation import arguments
from outlast.ecs.compilation.tick import Generator
from outlast.ecs.kernels.array_types import CheckedColumn, ColumnType
from outlast.ecs.kernels.jit import kernel
from tests.conftest import compiled_only, draw_actions, few_by_day
from tests.helpers import toy_game
from tests.helpers.execution_modes import LEVELS, short
from tests.helpers.toy_game import Place

ROW, TABLE = ColumnType(types.float32, 1), ColumnType(types.float32, 2)
READ_ONLY = ColumnType(types.float32, 2, readonly=True)


class FromStart(np.ndarray):
    """An array in plain Python that refuses negative indices."""

    def __getitem__(self, index: Any) -> Any:
        self._check(index)
        return super().__getitem__(index)

    def __setitem__(self, index: Any, value: Any) -> None:
        self._check(index)
        super().__setitem__(index, value)

    @staticmethod
    def _check(index: Any) -> None:
        for part in index if isinstance(index, tuple) else (index,):
            if isinstance(part, (int, np.integer)) and part < 0:
                raise IndexError(f"a kernel counts from the end: {index}")


@pytest.mark.slow
@compiled_only
@pytest.mark.parametrize("name", ["ffa_1", "teams_3", *few_by_day(LEVELS, ())])
def test_no_kernel_of_outlast_counts_from_the_end(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = arguments._python_array
    monkeypatch.setattr(arguments, "_python_array", lambda *given: made(*given).view(FromStart))
    game = short(name).replace(physics_backend="portable")
    labels = [system.label for system in game.worlds(1).schedule.systems]
    env, generator = make_vec(game, 2, seed=5, interpret=labels), np.random.default_rng(5)
    env.reset()
    for _ in range(40):
        env.step(draw_actions(env, generator))


def test_the_array_that_refuses_refuses() -> None:
    array = np.arange(6.0).reshape(2, 3).view(FromStart)
    array[1, 2] = array[0][1]
    for index in (-1, (0, -2), np.int32(-1)):
        with pytest.raises(IndexError, match="counts from the end"):
            array[index]
        with pytest.raises(IndexError, match="counts from the end"):
            array[index] = 0


@compiled_only
@pytest.mark.parametrize(
    ("function", "kind"),
    [
        (lambda a: a[-1], ROW),
        (lambda a: a[0, -1], TABLE),
        (lambda a: a[-2][0], TABLE),
        (lambda a: setitem(a, -1, 0), ROW),
    ],
)
def test_a_negative_index_that_is_known_is_refused(function: Any, kind: Any) -> None:
    with pytest.raises(NumbaError, match="of a column: count from the start"):
        kernel(function).compile((kind,))


@compiled_only
def test_parts_of_columns_are_columns() -> None:
    assert TABLE.copy(ndim=1) == ROW
    assert READ_ONLY.copy(ndim=1) == ColumnType(types.float32, 1, readonly=True)
    assert READ_ONLY.copy(ndim=1) != ROW
    assert type(TABLE.copy(layout="A")) is types.Array
    assert ROW.mangling_args != types.Array(types.float32, 1, "C").mangling_args


@compiled_only
def test_units_of_others_have_arrays_that_count_from_the_end_and_are_checked() -> None:
    def last(place: Read[Place], rows: Rows[Place]) -> None:
        if place.x[-1] != place.x[place.x.size - 1]:
            raise ValueError("not the last one")

    toy_game.run(Worlds((*toy_game.GAME, toy_game.system_of(last)), 3), toy_game.RESET, toy_game.STEP)
    assert Generator(Worlds(toy_game.GAME, 1).layout, outside=True).checked


@compiled_only
def test_with_bounds_checks_there_are_no_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    view = arguments.View(np.dtype("f4"), 1)
    monkeypatch.setattr(arguments.config, "BOUNDSCHECK", 0)
    assert view.type == ColumnType(types.float32, 1, readonly=True)
    monkeypatch.setattr(arguments.config, "BOUNDSCHECK", 1)
    assert type(view.type) is CheckedColumn
