"""Code that would give a silent wrong number is refused: variables without a value, and one random number for two."""

import ast
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.compiler import run_frontend
from numba.np import arrayobj

from outlast.components import Body, Hit, Phase, SelfView, Side
from outlast.ecs import (
    Archetype,
    Array,
    Clock,
    Component,
    DeclarationError,
    Entity,
    Field,
    Module,
    Observation,
    Offset,
    Random,
    RangeError,
    Read,
    Rows,
    Singleton,
    Write,
    column,
    number,
)
from outlast.ecs.checks.abstract_values import rounds
from outlast.ecs.checks.assignment_check import first_unassigned
from outlast.ecs.checks.random_check import repeated_draw
from outlast.ecs.compilation.compile_errors import of_numba
from outlast.ecs.kernels import random as draws
from outlast.ecs.kernels.random import integer, normal, uniform
from outlast.envs.core.make import make_vec
from outlast.envs.scenarios.variants import variant
from tests.conftest import COMPILED

# ---- variables


def last_found(n: int) -> int:
    for k in range(n):
        if k > 3:
            found = k
    return found


def earlier_round(n: int) -> int:
    total = 0
    for k in range(n):
        if k > 3:
            found = k
        total += found
    return total


def one_branch(n: int) -> int:
    if n > 3:
        found = n
    elif n > 1:
        found = 2 * n
    return found


def skipped(n: int) -> int:
    while n > 3:
        n -= 1
        if n == 5:
            continue
        found = n
    return found


def skips_rounds(n: int) -> int:
    for k in range(0, 9, 4):
        if k >= n:
            continue
        found = n
    return found


def no_round(n: int) -> int:
    for k in range(3, 3):
        found = n + k
    return found


def always(n: int) -> int:
    while True:
        found = n
        n -= 1
        if found < 3:
            break
    return found


def or_raised(n: int) -> int:
    if n > 3:
        found = n
    else:
        raise ValueError("too few")
    return found


def or_left(n: int) -> int:
    for k in range(n):
        if k > 3:
            found = k
            break
    else:
        return 0
    return found


def both_branches(n: int) -> int:
    total, found = 0, -1
    for k in range(n):
        step = k if k % 2 else 2 * k
        if n > 3 and k > 1:
            found = step
        else:
            found, total = -k, total + step
    return found + total


@pytest.mark.parametrize("function", [last_found, earlier_round, one_branch, skipped, skips_rounds, no_round])
def test_a_variable_that_may_have_no_value_is_found(function: Callable[[int], int]) -> None:
    """Python says the same of some number."""
    name, line = first_unassigned(run_frontend(function)) or ("", 0)
    assert name == "found"
    assert function.__code__.co_firstlineno < line <= function.__code__.co_firstlineno + 9
    with pytest.raises(UnboundLocalError):
        any(function(n) < 0 for n in range(9))


ROUNDS = 3


def first_round(n: int) -> int:
    for k in range(ROUNDS):
        found = n + k
        if found % 5 == 0:
            break
    return found + k


@pytest.mark.parametrize("function", [always, or_raised, or_left, both_branches, first_round])
def test_a_variable_with_a_value_on_every_path_is_not(function: Callable[[int], int]) -> None:
    assert first_unassigned(run_frontend(function)) is None
    for n in range(9):
        try:
            function(n)
        except ValueError:
            assert function is or_raised


@pytest.mark.parametrize("given", ["", "0, 3, 0", "2.5", "1, 2, 3, 4"])
def test_what_range_does_not_take_is_no_loop_that_has_a_round(given: str, tmp_path: Path) -> None:
    """Python says so when it runs."""
    path = tmp_path / "odd.py"
    path.write_text(f"def odd(n):\n    for k in range({given}):\n        found = k\n    return found\n")
    odd = runpy.run_path(str(path))["odd"]
    assert first_unassigned(run_frontend(odd)) == ("found", 4)
    assert not rounds([*ast.literal_eval(f"[{given}]")])
    with pytest.raises((TypeError, ValueError), match=r"range|integer"):
        odd(1)


class Prey(Component):
    prey: Array = column("i4", fill=-1, unit="entity")
    x: Array = column("f4")
    y: Array = column("f4")
    drawn: Array = column("i4")


def played(function: Callable[..., Any], phase: Phase = Phase.LOOK, **order: Any) -> Any:
    """Worlds with a mechanic of that one system, after a reset."""
    members = {"archetypes": lambda self: [Archetype("agent", (Prey(),))]}
    mechanic = type("Hunt", (Module,), members)
    mechanic.system(phase, **order)(function)
    env = make_vec(variant("ffa_1").with_(mechanic()), 2, seed=0)
    env.reset()
    return env


def nearest(body: Read[Body], agents: Rows[Side]) -> int:
    for e in agents:
        if body.x[e] > 1e6:
            best = e
    return best


def test_a_system_is_refused_also_for_what_it_calls() -> None:
    def choose(prey: Write[Prey], body: Read[Body], agents: Rows[Prey]) -> None:
        for e in agents:
            for o in agents:
                if body.x[o] > 1e6:
                    best = o
            prey.prey[e] = best

    def ask(prey: Write[Prey], body: Read[Body], agents: Rows[Prey]) -> None:
        for e in agents:
            prey.prey[e] = helper(e)

    with pytest.raises(DeclarationError, match=r"hunt\.choose .*on some path 'best' has no value here.*best = -1"):
        played(choose)
    with pytest.raises(
        DeclarationError, match=r"hunt\.ask \(test_code_checks.py, line \d+\): on some path 'found' has"
    ):
        played(ask)


def helper(e: int) -> int:
    if e > 100:
        found = e
    return found


# ---- loops


def spins(prey: Write[Prey], agents: Rows[Prey]) -> None:
    while True:
        prey.drawn[agents[0]] += 1


def spins_in_a_loop(prey: Write[Prey], agents: Rows[Prey]) -> None:
    for e in agents:
        while True:
            prey.drawn[e] += 1


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (
            spins,
            r"hunt\.spins \(test_code_checks\.py, line \d+\): this loop never ends, .*; leave it by break or return",
        ),
        pytest.param(
            spins_in_a_loop,
            r"hunt\.spins_in_a_loop .* does a loop in it never end\?",
            marks=pytest.mark.skipif(not COMPILED, reason="numba refuses it, and Python runs it"),
        ),
    ],
)
def test_a_loop_that_nothing_leaves_is_refused(function: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        played(function)


# ---- random numbers


def twice(key: Any, e: int) -> float:
    return float(uniform(key, e) + uniform(key, e))


def two_kinds(key: Any, ids: Any, e: int) -> float:
    one = draws.normal(key, 2 * ids[e])
    return float(one) + float(integer(key, 2 * ids[e], 4))


def two_indices(key: Any, ids: Any, e: int) -> float:
    return float(uniform(key, 2 * ids[e]) + uniform(key, 2 * ids[e] + 1))


def counted(key: Any, ids: Any, e: int) -> float:
    one = uniform(key, ids[e])
    ids[e] += 1
    return float(one + uniform(key, ids[e]))


def counted_in_a_variable(key: Any, e: int) -> float:
    one = uniform(key, e)
    e = e + 1
    return float(one + normal(key, e))


def either(key: Any, e: int) -> float:
    if e > 3:
        return float(uniform(key, e))
    return float(uniform(key, e)) / 2


def every_round(key: Any, ids: Any) -> None:
    for k in range(len(ids)):
        ids[k] = integer(key, 0, 4)


def inner_round(key: Any, ids: Any, first: int) -> None:
    for k in range(3):
        index = first + k
        for e in range(len(ids)):
            ids[e] += draws.integer(key, 2 * index, 4)


def round_by_round(key: Any, ids: Any) -> None:
    index = 0
    for e in ids:
        ids[e] += integer(key, e, 4)
        ids[e] += integer(key, len(ids) + index, 4)
        index += 2


def one_of_them(key: Any, ids: Any) -> None:
    for k in range(len(ids)):
        if ids[k] == 3:
            ids[k] = integer(key, 0, 4)


def first_of_them(key: Any, ids: Any) -> float:
    for k in range(len(ids)):
        if ids[k] == 3:
            break
    return float(uniform(key, 0))


@pytest.mark.parametrize("function", [twice, two_kinds, every_round, inner_round])
def test_two_draws_at_one_index_are_found(function: Any) -> None:
    assert repeated_draw(run_frontend(function)) > function.__code__.co_firstlineno


@pytest.mark.parametrize(
    "function", [two_indices, counted, counted_in_a_variable, either, round_by_round, one_of_them, first_of_them]
)
def test_draws_at_other_indices_are_not(function: Any) -> None:
    assert repeated_draw(run_frontend(function)) is None


def test_draws_that_are_one_number_are_refused() -> None:
    def scatter(prey: Write[Prey], entities: Read[Entity], agents: Rows[Prey], key: Random) -> None:
        for e in agents:
            prey.x[e] = uniform(key, entities.identity[e])
            prey.y[e] = uniform(key, entities.identity[e])

    def cut(prey: Write[Prey], agents: Rows[Prey], key: Random) -> None:
        for e in agents:
            prey.x[e] = uniform(key, 0.5 * e)

    def none(prey: Write[Prey], agents: Rows[Prey], key: Random) -> None:
        for e in agents:
            prey.drawn[e] = integer(key, e, 0)

    def part(prey: Write[Prey], agents: Rows[Prey], key: Random) -> None:
        for e in agents:
            prey.drawn[e] = integer(key, e, 2.5)

    for function, message in (
        (scatter, r"hunt\.scatter \(.*\) draws at an index at which it has drawn already"),
        (cut, r"hunt\.cut \(.*\): draws with a float as index, which cuts it off"),
        (none, r"hunt\.none \(.*\): draws an integer below 0: the bound is 1 or more"),
        (part, r"hunt\.part \(.*\): draws with a float as bound"),
    ):
        with pytest.raises(DeclarationError, match=message):
            played(function)


# ---- events


def test_the_count_of_an_event_stays_in_its_list() -> None:
    def cancel(hits: Write[Hit], agents: Rows[Prey]) -> None:
        hits.count[0] -= 1

    env = played(cancel, Phase.MELEE, before="melee.strike")
    with pytest.raises(
        RangeError, match=r"Hit\.count after hunt\.cancel: an integer is out of the range .*: 0 to 4 is"
    ):
        env.step(np.zeros((2, 2, len(env.action_sizes)), int))


def test_an_error_that_numba_raises_names_no_line_of_its_own() -> None:
    def compare(prey: Write[Wide], agents: Rows[Prey]) -> None:
        if prey.wide > 0:
            prey.wide[0] = 1

    mechanic = type("Hunt", (Module,), {"archetypes": lambda self: [Archetype("agent", (Prey(),))]})
    mechanic.singletons = lambda self: [Wide()]
    mechanic.system(Phase.DRIVE)(compare)
    env = make_vec(variant("ffa_1").with_(mechanic()), 1, seed=0)
    env.reset()
    with pytest.raises(
        ValueError, match=r"^(hunt\.compare: )?The truth value of an array with more than one element is amb"
    ):
        env.step(np.zeros((1, 2, len(env.action_sizes)), int))


@pytest.mark.parametrize(
    ("file", "own"),
    [
        (arrayobj.__file__, True),
        ("/another/venv/lib/site-packages/numba/np/arrayobj.py", True),  # that has compiled what is in the cache
        ("/home/me/numba/game.py", False),
        ("/home/me/numba", False),
        ("game.py", False),
    ],
)
def test_files_of_numba_are_known_wherever_it_is_installed(file: str, own: bool) -> None:
    assert of_numba(file) is own


class Wide(Singleton):
    wide: Array = column("f4", 3)


# ---- what a scenario has


def test_a_kind_is_in_the_world_after_reset_or_not() -> None:
    class Here(Module):
        def archetypes(self) -> Any:
            return [Archetype("agent", (Prey(),), alive=False)]

    with pytest.raises(
        DeclarationError, match=r"one module has 'agent' in the world right after reset, and another one"
    ):
        make_vec(variant("ffa_1").with_(Here()), 1)


def test_a_kind_of_entities_that_there_is_nowhere_is_refused() -> None:
    worlds = make_vec("ffa_1", 1).worlds
    assert worlds.span("box") == slice(0, 0)  # another mechanic's
    with pytest.raises(
        DeclarationError, match=r"there are no entities of the kind 'agents'; did you mean agent\? known"
    ):
        worlds.span("agents")


def test_a_column_is_not_called_as_what_components_have() -> None:
    with pytest.raises(DeclarationError, match=r"Wrong\.columns: no column can be called so"):
        type("Wrong", (Component,), {"columns": column("i4")})


@dataclass(frozen=True)
class Spoken(Module):
    size: int = number(1, low=1, high=9, about="columns of the field")

    def fields(self) -> Any:
        return {"own": (Field("said", size=self.size),)}


def say_one_before(view: Write[SelfView], agents: Rows[Side], own_said: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_said - 1] = 1


def say_some(view: Write[SelfView], agents: Rows[Side], own_said: Offset) -> None:
    for i in range(agents.size):
        for k in range(2):
            view.own[i, own_said + k] = 1


def say_the_third(view: Write[SelfView], agents: Rows[Side], own_said: Offset) -> None:
    for i in range(agents.size):
        view.own[i, 2 + own_said] = 1


def say_every_second(view: Write[SelfView], agents: Rows[Side], own_said: Offset) -> None:
    for i in range(agents.size):
        for k in range(1, 6, 2):
            view.own[i, own_said + (k - 1) // 2] = 1
            view.own[i, 2 * k - 2 + own_said] = 1


def say_at_once(view: Write[SelfView], agents: Rows[Side], own_said: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_said + 1 : own_said + 3] = 1


@pytest.mark.parametrize(
    ("function", "size", "fits"),
    [
        (say_one_before, 1, False),
        (say_one_before, 3, False),
        (say_some, 1, False),
        (say_some, 2, True),
        (say_every_second, 8, False),
        (say_every_second, 9, True),
        (say_at_once, 2, False),
        (say_at_once, 3, True),
        (say_the_third, 2, False),
        (say_the_third, 3, True),
    ],
)
def test_a_system_writes_no_columns_beside_its_field(function: Any, size: int, fits: bool) -> None:
    mechanic = type("Speech", (Spoken,), {})
    mechanic.system(Phase.OBSERVE)(function)
    game = variant("ffa_1").with_(mechanic(size=size))
    if fits:
        env = make_vec(game, 1, seed=0)
        assert env.reset()[0]["own"][..., env.fields["own"]["said"].columns].max() == 1
    else:
        with pytest.raises(DeclarationError, match=rf"writes SelfView\.own beside the {size} of own_said; take an Off"):
            make_vec(game, 1)


class Flash(Observation):
    flash: Array = column("f4", "agents", 1)


class Flashes(Module):
    def singletons(self) -> Any:
        return [Flash()]


@Flashes.system(Phase.OBSERVE)
def flash_once(view: Write[Flash], clock: Read[Clock], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        if clock.tick[0] == 3:
            view.flash[i, 0] = 1


def test_an_observation_that_is_not_always_written_is_not_of_the_last_episode() -> None:
    env = make_vec(variant("ffa_1").with_(Flashes()), 1, seed=0)
    noop = np.broadcast_to(env.noop, (1, 2, len(env.action_sizes)))
    for _ in range(2):
        seen = [env.reset(seed=0)[0]["flash"].max(), *(env.step(noop)[0]["flash"].max() for _ in range(4))]
        assert seen == [0, 0, 0, 1, 1]
