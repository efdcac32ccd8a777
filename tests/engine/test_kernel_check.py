"""What a system does is compared with what it declares, before anything is compiled and in milliseconds."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from outlast.components.health import hurt
from outlast.ecs import (
    Add,
    Bitset,
    Component,
    DeclarationError,
    Module,
    Read,
    Rows,
    ScheduleError,
    Worlds,
    Write,
    column,
    kernel,
)
from outlast.ecs.checks.kernel_check import check
from outlast.ecs.kernels.simd import store
from tests.helpers import toy_game
from tests.helpers.toy_game import Energy, Place, Walkers, system_of

HOME = Path(__file__).name
FLAG = True


class Drift(Component):
    amount: Any = column("f4")


def check_of(function: Callable[..., None]) -> None:
    check(system_of(function).registered[0])


@kernel
def slow_down(place: Any, e: int, factor: float) -> None:
    place.x[e] *= factor


@kernel
def columns_of(place: Any) -> Any:
    return place.x, place.trail


@kernel
def apply(fill: Any, e: int, tables: Any) -> None:
    fill(e, tables)


@kernel
def gain(energy: Any, e: int, amount: int) -> None:
    energy.left[e] += amount


@kernel
def misspelt(e: int) -> int:
    return e + amonut  # noqa: F821


# ---- columns and names that do not exist


def unknown_column(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = place.tral[e, 0]


def unknown_column_in_a_kernel(place: Write[Place], energy: Write[Energy], rows: Rows[Place]) -> None:
    for e in rows:
        hurt(energy, place, place, e, 1, 0, 1, 0)


def unknown_column_in_a_closure(energy: Read[Energy], place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        apply(moves, e, (energy, place))


@kernel
def moves(e: int, tables: Any) -> None:
    energy, place = tables
    place.x[e] = energy.right[e]


def unknown_column_of_an_alias(place: Read[Place], energy: Write[Energy], rows: Rows[Place]) -> None:
    there = place
    for e in rows:
        energy.left[e] = there.y[e]


def unknown_name(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = rowss.size  # noqa: F821


def unknown_name_in_a_kernel(place: Write[Place], rows: Rows[Place]) -> None:
    place.x[0] = misspelt(rows[0])


def unknown_member(place: Write[Place]) -> None:
    place.x[0] = np.sqroot(2)  # type: ignore[attr-defined]


def missing_argument(place: Write[Place]) -> None:
    slow_down(place, 0)  # type: ignore[call-arg]


def replaces_a_column(place: Write[Place]) -> None:
    place.x = place.trail


def writes_a_table(place: Write[Place]) -> None:
    place[0] = 1  # type: ignore[index]


@pytest.mark.parametrize(
    ("function", "line", "message"),
    [
        (unknown_column, 2, "Place has no column 'tral'; it has: x, trail; did you mean trail?"),
        (unknown_column_in_a_kernel, 2, "; health.py, line N; health.py, line N): Place has no column 'immune_to'"),
        (unknown_column_in_a_closure, 2, "Energy has no column 'right'; it has: left"),
        (unknown_column_of_an_alias, 3, "Place has no column 'y'; it has: x, trail"),
        (unknown_name, 2, "the name 'rowss' is not defined; did you mean rows or Rows?"),
        (unknown_name_in_a_kernel, 1, "the name 'amonut' is not defined"),
        (unknown_member, 1, "numpy has no 'sqroot'; did you mean sqrt or roots?"),
        (missing_argument, 1, "slow_down(): missing a required argument: 'factor'"),
        (replaces_a_column, 1, "a column cannot be replaced; write into it: Place.x[...] = ..."),
        (writes_a_table, 1, "Place is a table: write one of its columns, as in .x[...]"),
    ],
)
def test_what_does_not_exist_is_named(function: Callable[..., None], line: int, message: str) -> None:
    at = function.__code__.co_firstlineno + line
    with pytest.raises(DeclarationError, match=re.escape(message).replace("N", r"\d+")) as caught:
        Worlds([Walkers(), system_of(function)], 1)
    assert str(caught.value).startswith(f"local.{function.__name__} ({HOME}, line {at}")


# ---- writes to what is only read


def writes_an_element(place: Read[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = 0


def writes_in_place(place: Read[Place]) -> None:
    x = place.x
    x += 1


def writes_a_part(place: Read[Place]) -> None:
    first = place.trail[0]
    first[:] = 0


def writes_by_a_method(place: Read[Place]) -> None:
    place.x.fill(0)


def writes_through_a_view(place: Read[Place]) -> None:
    np.fill_diagonal(place.trail.reshape((-1, 2)), 0)


def writes_in_a_kernel(place: Read[Place]) -> None:
    slow_down(place, 0, 0.5)


def writes_what_a_kernel_returns(place: Read[Place]) -> None:
    x, _trail = columns_of(place)
    x[0] = 1


def writes_by_position(place: Read[Place]) -> None:
    place[0][0] = 1  # type: ignore[index]


def stores_a_vector(place: Read[Place]) -> None:
    store(place.x, 0, 1)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    "function",
    [
        writes_an_element, writes_in_place, writes_a_part, writes_by_a_method, writes_through_a_view,
        writes_in_a_kernel, writes_what_a_kernel_returns, writes_by_position, stores_a_vector,
    ],
)  # fmt: skip
def test_a_system_that_writes_what_it_reads_is_refused(function: Callable[..., None], compiled: bool) -> None:
    message = r"writes Place\.(x|trail), which its parameter list declares as Read; declare it Write\[Place\]"
    with pytest.raises(ScheduleError, match=message):
        Worlds([Walkers(), system_of(function, compiled=compiled)], 1)


def writes_rows(rows: Rows[Place]) -> None:
    rows[0] = 1


def writes_a_bitset(rows: Bitset[Place]) -> None:
    rows[0] |= 1


@pytest.mark.parametrize("function", [writes_rows, writes_a_bitset])
def test_lists_of_rows_are_read_only(function: Callable[..., None]) -> None:
    with pytest.raises(ScheduleError, match="writes 'rows', which is read-only and the same for all worlds; take a Sc"):
        check_of(function)


# ---- Add


def overwrites(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] = 7


def adds_by_hand(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] = energy.left[e] + 1


def multiplies(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] *= 2


def reads_what_it_adds_to(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        if energy.left[e] < 5:
            energy.left[e] += 1


def adds_itself(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] += energy.left[e]


def indexes_by_it(energy: Add[Energy], rows: Rows[Energy]) -> None:
    energy.left[energy.left[0]] += 1


def stores_another_sum(energy: Add[Energy], rows: Rows[Energy]) -> None:
    e = rows[0]
    total = energy.left[e]
    e = rows[1]
    total += 1
    energy.left[e] = total


def stores_elsewhere(energy: Add[Energy], place: Write[Place]) -> None:
    place.x[0] = energy.left[0]


def hands_it_to_numpy(energy: Add[Energy]) -> None:
    np.cumsum(energy.left)


def hands_it_to_a_lambda(energy: Add[Energy]) -> None:
    (lambda: energy.left[0])()


def overwrites_in_a_kernel(energy: Add[Energy]) -> None:
    apply(resets, 0, (energy, 1))


@kernel
def resets(e: int, tables: Any) -> None:
    tables[0].left[e] = tables[1]


def one_of_two(energy: Add[Energy], place: Write[Place], rows: Rows[Energy]) -> None:
    target = energy.left if rows.size > 2 else place.x
    target[0] = 1


def adds_floats(drift: Add[Drift], rows: Rows[Drift]) -> None:
    for e in rows:
        drift.amount[e] += 1


def adds_a_float(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] += 0.5 * e


@pytest.mark.parametrize(
    "function",
    [
        overwrites, adds_by_hand, multiplies, reads_what_it_adds_to, adds_itself, indexes_by_it, stores_another_sum,
        stores_elsewhere, hands_it_to_numpy, hands_it_to_a_lambda, overwrites_in_a_kernel, one_of_two, adds_floats,
        adds_a_float,
    ],
)  # fmt: skip
def test_add_allows_sums_of_integers_only(function: Callable[..., None]) -> None:
    with pytest.raises(ScheduleError, match=rf"local\.{function.__name__} \({HOME}, line \d+.*; declare Write\["):
        check_of(function)


def adds_in_every_way(energy: Add[Energy], place: Read[Place], rows: Rows[Energy], amount: int) -> None:
    left = energy.left
    for e in rows:
        energy.left[e] += amount if place.x[e] > 0 else -amount
        left[e] -= np.int32(place.x[e] + 0.5)
        energy.left[e : e + 1] += 1
        energy.left[:] -= 1
        gain(energy, e, 2)
        apply(gains, e, (place.x, energy))
    for k in range(energy.left.size):
        left[k] += len(left)


@kernel
def gains(e: int, tables: Any) -> None:
    x, energy = tables
    energy.left[e] += int(x[e])


def test_sums_are_followed_through_kernels_and_tuples() -> None:
    check_of(adds_in_every_way)


# ---- no false alarms


def what_cannot_be_followed(place: Read[Place], energy: Write[Energy], rows: Rows[Place]) -> None:
    table: Any = place if FLAG else energy
    table.left[0] = 1
    x = place.x.copy()
    x[0] = place.x[1]
    first, count = place.x[0], place.x.size
    first += 1
    count += 1
    for left in (energy.left, energy.left):
        left[0] = int(first)
    pair = [place, place]
    pair[0].nothing = 1  # type: ignore[attr-defined]
    SimpleNamespace(a=place).a.nothing[0] = 1


def test_what_cannot_be_followed_is_left_to_the_compiler() -> None:
    check_of(what_cannot_be_followed)


def test_the_systems_of_outlast_and_of_the_tests_pass() -> None:
    systems = Module.imported_systems()
    systems = [system for system in systems if system.function.__module__.startswith(("outlast.", toy_game.__name__))]
    assert len(systems) > 50
    for system in systems:
        check(system)


def test_a_recursive_kernel_is_checked_once() -> None:
    check_of(counts_down)


@kernel
def count_down(place: Any, k: int) -> int:
    return count_down(place, k - 1) if k > 0 else 0


def counts_down(place: Read[Place]) -> None:
    count_down(place, 3)


def cuts_a_float_off(energy: Write[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] -= 1.5


def cuts_a_share_off(energy: Write[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] = rows.size / 2


def says_that_it_cuts(energy: Write[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] = np.int32(rows.size / 2)


def test_a_float_in_a_column_of_integers_is_said_to_be_cut_off() -> None:
    for function in (cuts_a_float_off, cuts_a_share_off):
        with pytest.raises(
            DeclarationError, match=r"writes a float to Energy\.left, int32, .* as in np\.int32\(\.\.\.\)"
        ):
            check_of(function)
    check_of(says_that_it_cuts)
