"""Slips in systems are refused when worlds are made, before anything is compiled; systems without slips are not.

Each slip is a system of the toy game: its parameters, its body, and what is said of it. Most are found as the system
runs on stand-ins; those behind `if hidden` are in branches that no trial takes: the source or the compiler shows them.
"""

import math
import re
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import pytest

import outlast
from outlast import ecs
from outlast.components import Phase, SelfView, Side
from outlast.components.health import hurt
from outlast.ecs import (
    Archetype,
    Array,
    Component,
    DeclarationError,
    EngineError,
    Field,
    Module,
    Offset,
    Rows,
    ScheduleError,
    Singleton,
    Worlds,
    Write,
    column,
    kernel,
    number,
    of,
)
from outlast.ecs.checks import trial
from outlast.ecs.kernels import random as draws
from outlast.ecs.kernels.random import integer, normal, uniform
from outlast.ecs.kernels.simd import load, store
from outlast.envs.scenarios.hide_and_seek import SCENARIOS
from outlast.systems import Behaviour, FineMotors, Lidar, Maze, Pillars, Rooms, Walls
from tests.conftest import COMPILED, few_by_day, scaled
from tests.helpers import toy_game
from tests.helpers.beasts import Beasts
from tests.helpers.execution_modes import assert_stand_ins_change_nothing
from tests.helpers.mechanics import kind, written
from tests.helpers.toy_game import RESET, STEP, Energy, Place, Toy, Walkers

ROUNDS = 3
VARIANTS = [f"{kind}_{k}" for kind in ("ffa", "teams") for k in range(1, 5)]
USED = draws, hurt, integer, load, math, normal, store, uniform, Offset, Rows, SelfView, Side, Write, of  # by texts
MORE: dict[str, Any] = {
    **{name: lambda game=game: game for name, game in SCENARIOS.items()},
    "tag": lambda: example("tag")["TAG"],
    "poison": lambda: outlast.variant("teams_2").with_(example("poison")["Poison"]()),
    **{
        kind.__name__: lambda kind=kind: outlast.variant("teams_3").with_(kind())
        for kind in (Behaviour, FineMotors, Lidar, Maze, Pillars, Rooms, Walls)
    },
}


def example(name: str) -> dict[str, Any]:
    """What a file of docs/examples defines."""
    return runpy.run_path(str(Path(__file__).parents[2] / "docs" / "examples" / f"{name}.py"))


class Stone(Component):
    """What comes ahead of all walkers, so that their rows are not their indices."""

    amount: Array = column("f4", fill=2.7)
    whole: Array = column("i4")
    small: Array = column("u1")


class Mark(Singleton):
    walker: Array = column("i4", "walkers")
    stone: Array = column("i4", 2)


@dataclass(frozen=True)
class Local(Toy):
    worth: int = number(2)
    shares: tuple[float, ...] = number((1.0, 2.0), low=0)

    def archetypes(self) -> Any:
        return [Archetype("stone", (Place(), Stone()), 2, order=-1)]

    def singletons(self) -> Any:
        return [Mark()]


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
def resets(e: int, tables: Any) -> None:
    tables[0].left[e] = tables[1]


@kernel
def gains(e: int, tables: Any) -> None:
    x, energy = tables
    energy.left[e] += int(x[e])


@kernel
def gain(energy: Any, e: int, amount: int) -> None:
    energy.left[e] += amount


@kernel
def sets(energy: Any, e: int) -> None:
    energy.left[e] = 1


@kernel
def set_one(numbers: Any, e: int, value: Any = 1) -> None:
    numbers[e] = value


@kernel
def misspelt(e: int) -> int:
    return e + amonut  # noqa: F821


@kernel
def found_or_not(n: int) -> int:
    if n > 100:
        found = n
    return found


@numba.njit
def their_own(n: int) -> int:
    while n > 100:
        found = n
    return found


@numba.njit
def flat_element(values: Any, far: int) -> Any:
    return values.flat[far]


@kernel
def count_down(place: Any, k: int) -> int:
    return count_down(place, k - 1) if k > 0 else 0


PARAMETERS = {  # what stands for a parameter in the tables below; else "name" is Read, "name=" Write and "name+" Add
    "rows": "Rows[Energy]", "all": "Rows[Place]", "bits": "Bitset[Place]", "index": "RowIndex[Energy]", "key": "Random",
    "stones": "RowIndex[Stone]", "worth": "int", "shares": "tuple[float, ...]",
}  # fmt: skip
ACCESS = {"=": "Write", "+": "Add"}
NO_WRITE = "writes Place.x, which its parameter list declares as Read; declare it Write[Place]"
NO_ARRAY = "writes an array that its parameter list declares as Read; declare it Write"
ONLY_SUMS = "Energy.left, but declares Add[Energy], which allows column[...] += integer and -= only; declare Write[En"
FLOAT = "a float to Energy.left, int32"
SHARED = "writes 'rows', which is read-only and the same for all worlds; take a Scratch or a column of a component"
AN_INDEX = "indexes Mark.walker, which has 3 ('walkers'), with a row of Rows[Energy]: take an index in that list"
A_ROW = "which is by row, with an index in Rows[Energy]: take the row, which Rows[Energy] has there"
NO_VALUE = "on some path 'found' has no value here, where machine code takes 0"
AGAIN = "draws at an index at which it has drawn already"
ENDLESS = "this loop never ends, and nothing interrupts machine code; leave it by break or return"

SLIPS: list[tuple[str, str, str]] = [  # parameters, body, and a part of the message
    # names
    ("place energy= rows", "energy.left[e] = place.tral[e, 0]", "Place has no column 'tral'; it has: x, trail; d"),
    ("place energy= rows", "hurt(energy, place, place, e, 1, 0, 1, 0, -1)", "has no column 'immune_to'; it has: x, t"),
    ("place energy= rows", "there = place\nenergy.left[rows[0]] = there.y[0]", "Place has no column 'y'"),
    ("energy= rows", "energy.left[e] = rowss.size", "name 'rowss' is not defined; did you mean rows"),
    ("energy=", "energy.left[0] = misspelt(0)", "name 'amonut' is not defined"),
    ("energy=", "energy.left[0] = np.sqroot(2)", "no attribute 'sqroot'; did you mean sqrt or roots?"),
    ("place=", "slow_down(place, 0)", "slow_down() missing 1 required positional argument: 'factor'"),
    ("place", "place.x = place.trail", "a column cannot be replaced; write into it"),
    ("place", "place[0] = 1", "'Place' object does not support item assignment"),
    # writes to what is only read
    ("place rows", "place.x[e] = 0", NO_WRITE),
    ("place", "x = place.x\nx += 1", NO_WRITE),
    ("place", "first = place.trail[0]\nfirst[:] = 0", "writes Place.trail, which its parameter list declares as Read"),
    ("place", "np.ascontiguousarray(place.x)[0] = 7.0", NO_ARRAY),
    ("place", "np.fill_diagonal(place.trail.reshape((-1, 2)), 0)", NO_ARRAY),
    ("place", "for value in np.nditer(place.x): value[()] = 7.0", NO_ARRAY),
    ("place", "slow_down(place, 0, 0.5)", NO_WRITE),
    ("place", "x, _ = columns_of(place)\nx[0] = 1", NO_WRITE),
    ("place", "place[0][0] = 1", NO_WRITE),
    ("place", "store(place.x, 0, load(place.x, 0))", NO_WRITE),
    ("rows", "rows[0] = 1", SHARED),
    ("bits", "bits[0] |= 1", SHARED.replace("rows", "bits")),
    # sums
    ("energy+ rows", "energy.left[e] = 7", ONLY_SUMS),
    ("energy+ rows", "energy.left[e] = energy.left[e] + 1", ONLY_SUMS),
    ("energy+ rows", "if hidden: energy.left[0] *= 2", ONLY_SUMS),
    ("energy+ rows", "if hidden: sets(energy, 0)", ONLY_SUMS),
    ("energy+ rows", "left = energy.left\nif hidden: left[0] = 1", ONLY_SUMS),
    ("energy+ rows", "if energy.left[rows[0]] < 5: energy.left[rows[0]] += 1", ONLY_SUMS),
    ("energy+ rows", "energy.left[e] += energy.left[e]", ONLY_SUMS),
    ("energy+ rows", "energy.left[energy.left[0]] += 1", ONLY_SUMS),
    ("energy+ rows", "e = rows[0]\ntotal = energy.left[e]\ne = rows[1]\ntotal += 1\nenergy.left[e] = total", ONLY_SUMS),
    ("energy+ place=", "place.x[0] = energy.left[0]", ONLY_SUMS),
    ("energy+", "np.cumsum(energy.left)", ONLY_SUMS),
    ("energy+", "(lambda: energy.left[0])()", ONLY_SUMS),
    ("energy+", "apply(resets, 0, (energy, 1))", ONLY_SUMS),
    ("energy+", "tables = [energy]\ntables[0].left[0] -= 1\ntables[0].left[0] <<= 1", ONLY_SUMS),
    ("energy+ rows place=", "target = energy.left if rows.size > 9 else place.x\ntarget[0] = 1", ONLY_SUMS),
    ("stone+", "stone.amount[0] += 1", "Stone.amount, float32, and only sums of integers do not depend on"),
    ("energy+ rows", "energy.left[e] += 0.5 * e", "adds " + FLOAT),
    ("energy+", "energy.left[0] += math.sqrt(0.36)", "adds " + FLOAT),
    # what a column cannot hold
    ("energy= rows", "energy.left[e] -= 1.5", "writes " + FLOAT),
    ("stone=", "stone.small[:] = np.abs(stone.amount)", "writes a float to Stone.small, uint8"),
    ("stone= key", "stone.whole[0] = 10 * uniform(key, 0)", "writes a float to Stone.whole, int32"),
    ("stone=", "stone.small[0] = 300", "integer 300 out of bounds for uint8"),
    # rows and indices
    ("place= rows", "for i in range(rows.size): place.x[i] = 1", "indexes Place.x, " + A_ROW),
    ("mark= rows", "mark.walker[e] = 1", AN_INDEX),
    ("mark= rows", "for i, e in enumerate(rows): mark.walker[e] = i", AN_INDEX),
    ("mark= rows", "mark.walker[0] = rows[e]", "indexes 'rows', which has 3, with a row of Rows[Energy]"),
    ("mark= rows", "set_one(mark.walker, e)", AN_INDEX),
    ("place= rows index", "place.x[index[e]] = 1", "indexes Place.x, " + A_ROW),
    ("mark= all", "for i in range(len(all)): mark.walker[i] = 1", "Mark.walker: index 3 is out"),
    ("place=", "place.x[100_000] = 1", "Place.x: index 100000 is out of bounds"),
    # memory that nothing checks
    ("place", "place.x.flat[300]", "takes .flat of an array, whose indices nothing checks; index the array"),
    ("place", "for x in place.x.flat: x + 1", "takes .flat"),
    ("rows", "if hidden: flat_element(np.zeros(3), 300)", "takes .flat"),
    ("place", "place.x.ctypes.data", "takes .ctypes of an array, an address that nothing checks"),
    ("place", "if hidden: as_strided(place.x, (9,), (4,))[9]", "calls as_strided, whose shape"),
    ("place", "if hidden: np.lib.stride_tricks.as_strided(place.x, (9,), (4,))[9]", "calls as_strided, whose shape"),
    ("place", "np.delete(place.x, np.array([300])).size", "calls np.delete, whose indices noth"),
    ("place=", "place.x[:2] += np.ones(5, np.float32)", "broadcast"),
    ("place", "np.add(place.x, place.x, np.zeros(300))", "broadcast"),
    ("place", "np.outer(place.x, place.x, np.zeros((1, 1)))", "broadcast"),
    # random numbers
    ("stone= key", "stone.amount[0] = uniform(key, 0) + uniform(key, 0)", AGAIN),
    ("stone= key rows", "for e in rows: stone.amount[0] = uniform(key, 0)", AGAIN),
    ("stone= key rows", "stone.amount[0] = uniform(key, e % 2)", AGAIN),
    ("stone= key", "stone.amount[0] = uniform(key, 0.5)", "draws with a float as index, which cuts it off"),
    ("stone= key", "stone.whole[0] = integer(key, 0, 0)", "draws an integer below 0: the bound is 1"),
    ("stone= key", "stone.whole[0] = integer(key, 0, 2.5)", "draws with a float as bound"),
    # variables and loops
    ("rows", "found = e if e > 100 else 0\nfor k in rows[:0]: other = k\nother + 1", "'other' has no value"),
    ("rows", "for e in rows:\n    if e > 100: found = e\n    rows[0] + found", NO_VALUE),
    ("rows", "if rows.size > 3: found = 1\nelif rows.size > 1: found = 2\nfound + 1", NO_VALUE),
    ("rows", "n = 9\nwhile n > 3:\n    n -= 1\n    if n == 5: continue\n    found = n\nfound + 1", NO_VALUE),
    ("rows", "for k in range(0, 9, 4):\n    if k >= rows[0]: continue\n    found = k\nfound + 1", NO_VALUE),
    ("rows", "for k in range(3, 3): found = k\nfound + 1", NO_VALUE),
    ("rows", "for k in range(ROUNDS): found = k\nfound + 1", NO_VALUE),
    ("rows", "if hidden: found_or_not(3)", NO_VALUE),
    ("rows", "if hidden: their_own(3)", NO_VALUE),
    ("energy=", "while True: energy.left[0] += 1", ENDLESS),
]  # fmt: skip

FOUND_BY_THE_COMPILER: list[tuple[str, str, str]] = [  # likewise, of branches that no trial takes
    ("place energy= rows", "if hidden: energy.left[0] = place.y[0]", "Unknown attribute 'y' of type Place("),
    ("place", "if hidden: place.x[0] = 0", NO_ARRAY),
    ("place", "x = place.x\nif hidden: x[0] += 1", NO_ARRAY),
    ("place", "if hidden: set_one(place.x, 0)", NO_ARRAY),
    ("place", "if hidden: slow_down(place, 0, 0.5)", NO_ARRAY),
    *(("stone=", f"if hidden: {line}", "writes a float to") for line in (
        "stone.whole[0] = abs(stone.amount[0])", "stone.whole[0] = max(stone.amount[0], 1)",
        "stone.whole[0] = stone.amount[0] if hidden else 0", "stone.whole[0] = stone.amount.sum()",
        "stone.whole[0] += abs(stone.amount[0])", "part = stone.whole[1:]; part[0] = abs(stone.amount[0])",
        "stone.small[:] = np.abs(stone.amount)", "set_one(stone.whole, 0, abs(stone.amount[0]))",
    )),
    ("energy= rows", "for e in rows:\n    while 1:\n        e += 1\n        for k in rows: break", "does a loop in it"),
]  # fmt: skip

CORRECT = [
    (
        "energy+ place rows worth",
        "left = energy.left\nfor e in rows:\n    energy.left[e] += worth if place.x[e] > 0 else -worth\n"
        "    left[e] -= np.int32(place.x[e] + 0.5)\n    energy.left[e : e + 1] += 1\n    energy.left[:] -= 1\n"
        "    gain(energy, e, 2)\n    apply(gains, e, (place.x, energy))\n"
        "for k in range(energy.left.size): left[k] += len(left)",
    ),
    ("place energy= rows", "x = place.x.copy()\nx[0] = place.x[1]\nfirst = x[0]\nfirst += 1\nenergy.left[rows] = 1"),
    ("energy= rows", "energy.left[e] = np.int32(rows.size / 2)"),
    ("place", "count_down(place, 3)"),
    ("clock energy= rows", "energy.left[e] = clock.tick[0] - e"),
    ("mark= energy= rows", "for i, e in enumerate(rows): mark.walker[i] = energy.left[e]"),
    ("mark= place= stones", "for e in range(stones.size):\n    if stones[e] >= 0: "
     "mark.stone[stones[e]] = np.int32(place.x[e])"),
    ("mark= shares", "for i, share in enumerate(shares): mark.stone[i] = int(share)"),
    ("mark= all", "for i in range(all.size):\n    if i < mark.walker.size: mark.walker[i] = 1"),
    ("stone=", "if hidden: stone.whole[0] = np.int32(stone.amount.sum()); stone.small[0] = True; stone.amount[0] = 2"),
    ("stone=", "stone.whole[0] = math.floor(stone.amount[0])\nstone.whole[1] = not stone.amount[0]\n"
     "stone.small[:] = 3\nstone.amount[:] = 2\nstone.small[0] = stone.amount[0] in (0.0, 1.0)"),
    ("stone= key rows", "index = 0\nfor e in rows:\n    stone.amount[0] = uniform(key, 2 * e)\n"
     "    stone.amount[0] += normal(key, 2 * e + 1)\n    if e == 3: stone.whole[0] = integer(key, 99, 4)"),
    ("rows", "n = 9\nwhile True:\n    found = n\n    n -= 1\n    if found < 3: break\nfound + 1"),
    ("rows", "for k in rows:\n    if k > 3:\n        found = k\n        break\nelse:\n    return\nfound + 1"),
    ("rows", "found = 0\nfor k in range(ROUNDS):\n    found += k\n    if found % 5 == 0: break\nfound + 1"),
    ("energy=", "energy.left[0] = 10 // energy.left[0]"),  # in Python, an error about numbers only
    ("place energy= rows", "for e in rows: energy.left[e] = np.int64(np.uint64(1) << e)"),  # numpy has no such shift
]  # fmt: skip


def system(parameters: str, body: str, **options: Any) -> Module:
    """A mechanic with one system, whose source is found. A body that uses `e`, but does not set it, is run for rows."""
    if re.search(r"\be\b", body) and not re.search(r"\be (=|in)", body):
        body = f"for e in rows:\n    {body}"
    declared = {word.rstrip("=+"): ACCESS.get(word[-1], "Read") for word in parameters.split()}
    kinds = {name: PARAMETERS.get(name, f"{access}[{name.title()}]") for name, access in declared.items()}
    lines = [f"def act({', '.join(map(': '.join, kinds.items()))}) -> None:", "hidden = np.zeros(1)[0] > 0"]
    text = "\n    ".join([*lines, *body.splitlines()]) + "\n"
    act = written(text, {**vars(ecs), **vars(toy_game), **globals()}, f"mine {hash(text)}.py")
    made = kind("Local", Local)
    made.system(toy_game.Phase.FEED, **options)(act)
    return made()


def tried(parameters: str, body: str, **options: Any) -> Worlds:
    return Worlds([Walkers(), system(parameters, body)], 1, **options)


@pytest.mark.parametrize(("parameters", "body", "words"), SLIPS)
def test_a_slip_is_named_with_its_line(parameters: str, body: str, words: str) -> None:
    with pytest.raises((EngineError, IndexError), match=re.escape(words)) as caught:
        tried(parameters, body)
    assert re.match(r"local\.act \(.*\.py, line \d+", str(caught.value))


@pytest.mark.skipif(not COMPILED, reason="as Python, they are errors once that branch is taken")
@pytest.mark.parametrize(("parameters", "body", "words"), FOUND_BY_THE_COMPILER)
def test_a_slip_that_no_trial_finds_is_not_compiled(parameters: str, body: str, words: str) -> None:
    with pytest.raises(EngineError, match=re.escape(words)) as caught:
        toy_game.run(tried(parameters, body), RESET)
    assert re.match(r"local\.act \(.*\.py, line \d+", str(caught.value))


@pytest.mark.parametrize(("parameters", "body"), CORRECT)
def test_a_system_without_a_slip_is_not_refused(parameters: str, body: str) -> None:
    tried(parameters, body)


@pytest.mark.parametrize("name", few_by_day([*VARIANTS, *MORE], ("teams_4", "hide and seek")))
def test_on_stand_ins_systems_do_the_same(name: str) -> None:
    assert_stand_ins_change_nothing(MORE[name]() if name in MORE else outlast.variant(name), scaled(60, least=4))


# ---- numbers in which roles differ


@dataclass(frozen=True)
class Spoken(Module):
    harm: float = number(15.0, per_agent=True)

    def fields(self) -> Any:
        return {"own": (Field("said"),)}


def mechanic(base: type[Module], body: str) -> Any:
    """A mechanic whose system writes observations of agents: `i` is an agent's index, `e` its row."""
    text = "def act(view: Write[SelfView], agents: Rows[Side], own_said: Offset, harm: float) -> None:\n"
    text += f"    for i, e in enumerate(agents):\n        {body}\n"
    made = kind("Speech", base)
    made.system(Phase.OBSERVE)(written(text, {**vars(ecs), **globals()}, f"mine {hash(text)}.py"))
    return made


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("view.own[i, own_said] = harm", r"computes with harm, in which roles differ: write of\(harm, e\)"),
        ("view.own[i, own_said] = max(harm, 5)", r"computes with harm, in which roles differ: write of\(harm, e\)"),
        ("view.own[i, own_said] = of(harm, i)", r"indexes harm, which is by row, with an index in Rows\[Side\]"),
        ("view.own[i, own_said] = of(harm, e)", ""),
    ],
)
def test_a_number_in_which_roles_differ_is_asked_for_by_row(body: str, words: str) -> None:
    game = outlast.variant("teams_2").with_(Beasts(order=0), mechanic(Spoken, body)())
    game = game.roles(one=outlast.role(1, speech_harm=4.0), rest=outlast.role())
    if not words:
        outlast.make_vec(game, 1)
        return
    with pytest.raises(DeclarationError, match=rf"^speech\.act \(.*\): {words}"):
        outlast.make_vec(game, 1)


# ---- trials


def test_an_equal_game_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    played = list[int]()
    monkeypatch.setattr(trial, "_play", lambda *_: played.append(1))
    monkeypatch.setattr(trial, "TRIED", {})
    for body in ("energy.left[0] = 1", "energy.left[0] = 1", "energy.left[0] = 2"):
        tried("energy=", body)
    Worlds([Walkers(count=4), system("energy=", "energy.left[0] = 2")], 1)
    assert len(played) == 3


def test_what_a_system_raises_itself_has_a_note() -> None:
    with pytest.raises(KeyError, match="far") as caught:
        tried("energy rows", "if energy.left[e] == 20: raise KeyError('far')")
    assert caught.value.__notes__ == [trial.NOTE.format("local.act")]
    assert caught.traceback[-1].name == "act"


def test_a_trial_ends_and_says_so(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    if sys.gettrace() is not None:
        pytest.skip("a debugger or coverage counts lines")
    monkeypatch.setattr(trial, "MOST_LINES", 5000)
    tried("energy= rows", "k = 0\nwhile energy.left[rows[0]] < 99: k += 1")
    assert re.search(r"mine .*, line \d+: the trial of local.act ended after 5000 lines", caplog.text)
    assert sys.gettrace() is None


PRINTED = list[int]()


def test_python_that_stays_python_runs_on_stand_ins_only_when_it_runs(capsys: pytest.CaptureFixture[str]) -> None:
    tried("rows", "print(rows.size)")
    assert capsys.readouterr().out == ""
    worlds = Worlds(
        [Walkers(), system("energy+ rows", "PRINTED.append(1)\nx = [energy]\nx[0].left[0] = 1", compiled=False)], 1
    )
    assert not PRINTED
    toy_game.run(worlds, RESET)
    with pytest.raises(ScheduleError, match=re.escape("writes " + ONLY_SUMS)):
        toy_game.run(worlds, STEP)
    assert PRINTED == [1]


@pytest.mark.usefixtures("untried")
def test_a_system_that_is_interpreted_runs_on_stand_ins() -> None:
    worlds = tried("energy= rows", "if energy.left[e] < 20: energy.left[e] = 0.5", interpret="local.act")
    toy_game.run(worlds, RESET, STEP)
    worlds[Energy].left[:] = 3
    with pytest.raises(DeclarationError, match=r"local\.act .* writes a float to Energy\.left, int32"):
        toy_game.run(worlds, STEP)
