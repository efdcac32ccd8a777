"""From systems to machine code: a unit each, compiled once, cached on disk, and never the wrong one."""

import os
import random
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from outlast.ecs import (
    Add,
    Archetype,
    Component,
    DeclarationError,
    Module,
    Random,
    Read,
    Rows,
    ScheduleError,
    Scratch,
    Worlds,
    Write,
    column,
    kernel,
    number,
)
from outlast.ecs.compilation import cache
from outlast.ecs.kernels.jit import OPTIONS, called_kernel
from outlast.ecs.kernels.machine_code import compile_function
from outlast.ecs.kernels.random import uniform
from tests.conftest import COMPILED, compiled_only, digest
from tests.helpers import toy_game
from tests.helpers.mechanics import kind
from tests.helpers.toy_game import (
    RESET,
    STEP,
    Energy,
    Food,
    Pay,
    Phase,
    Place,
    Toy,
    Walkers,
    Weather,
    make,
    run,
    system_of,
)

ROOT = Path(__file__).resolve().parents[2]


def compiled_by(worlds: Worlds) -> list[str]:
    """Labels of the systems that were compiled for these worlds, and not found."""
    run(worlds, STEP)
    worlds.close()
    return sorted(worlds.units.compiled)


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, on disk and in memory."""
    monkeypatch.setenv("OUTLAST_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache, "ADDRESSES", {})
    return tmp_path / "cache"


@compiled_only
def test_other_numbers_sizes_and_combinations_compile_nothing(cold: Path) -> None:
    """Each system has been compiled once, whatever the scenario, the threads and the number of worlds."""
    assert not Worlds(toy_game.GAME, 1).compiled
    first = compiled_by(make())
    assert Worlds(toy_game.GAME, 1).compiled
    assert {"clock", "run_units", "walkers.walk"} <= set(first)
    assert len(first) == len(list(cold.glob("*.unit")))
    for worlds in (
        make(Walkers(7, stride=3), Food(1, worth=0), Weather((0.0,), wild=False, sky="blue"), count=50, threads=2),
        make(Walkers()),
        make(Walkers(), Weather()),
    ):
        assert compiled_by(worlds) == []


@compiled_only
def test_an_edit_compiles_what_it_touches(cold: Path) -> None:
    """Another docstring touches nothing, a system's body its unit, a helper the units that call it."""
    cell = """
@kernel
def gain() -> int:
    return {gain}

@Local.system(Phase.FEED)
def act(energy: Add[Energy], rows: Rows[Energy]) -> None:
    {docstring}
    for e in rows:
        energy.left[e] += np.int32(gain())

@Local.system(Phase.FEED)
def rest(energy: Add[Energy], rows: Rows[Energy]) -> None:
    for e in rows:
        energy.left[e] += np.int32({rest})
"""

    local = kind("Local", Toy)

    def compiled_with(**parts: Any) -> list[str]:
        exec(cell.format(**parts), globals() | {"Local": local, "__name__": "notebook"})
        return compiled_by(make(Walkers(), local()))

    assert {"local.act", "local.rest"} < set(compiled_with(gain=1, docstring='"""Dine."""', rest=5))
    assert compiled_with(gain=1, docstring='"""Eat."""', rest=5) == []
    assert compiled_with(gain=1, docstring='"""Eat."""', rest=6) == ["local.rest"]
    assert compiled_with(gain=2, docstring='"""Eat."""', rest=6) == ["local.act"]


@compiled_only
@pytest.mark.skipif(sys.platform != "linux", reason="others compile in one process")
@pytest.mark.parametrize("killed", [False, True])
def test_several_processes_compile_the_same(cold: Path, monkeypatch: pytest.MonkeyPatch, killed: bool) -> None:
    monkeypatch.setattr(cache, "_cores", lambda: 3)
    monkeypatch.setattr(cache, "UNITS_PER_PROCESS", 1)
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    if killed:
        monkeypatch.setattr(cache, "_spread", lambda labels, work, *rest, **options: work(labels[0]))
    worlds = run(make(Walkers()), STEP, STEP)
    assert len(list(cold.glob("*.unit"))) == len(worlds.units.compiled)
    assert digest(worlds) == digest(run(make(Walkers()), STEP, STEP))


def test_the_source_of_a_tick() -> None:
    worlds = make()
    source = worlds.source()
    labels, zero = re.findall(r"def unit.*# (.*)", source), "zero tests.helpers.toy_game.Pay.pay (reset, step)"
    assert labels.pop(1) == "zero tests.helpers.toy_game.Line.line (reset)"  # an observation of one's own
    assert labels.pop() == "zero tests.helpers.toy_game.Pay.pay (reset)"  # the tick that starts an episode pays nothing
    checks = [f"outlast.ecs.declarations.component.Entity.{column} after food.grow" for column in ("alive", "identity")]
    assert [label for label in labels if label not in (zero, *checks)] == [
        "clock",
        *(s.label for s in worlds.schedule.systems),
    ]
    k = labels.index("food.grow") + 1
    assert labels[k : k + 2] == checks
    writer = next(s.label for s in worlds.schedule.systems if s.touches(Pay, "write", "add"))
    assert labels[labels.index(writer) - 1] == zero
    assert re.findall(r"^# ---- (\w+)", source, re.MULTILINE) == ["BEGIN", "MOVE", "FEED", "SHOW"]
    compile(source, "source", "exec")


@compiled_only
def test_a_kernel_prints(cold: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def act(rows: Rows[Energy]) -> None:
        print("rows:", rows.size)

    for _ in range(2):
        run(make(Walkers(2), system_of(act), count=1), STEP)
        cache.ADDRESSES.clear()
    assert capfd.readouterr().out == "rows: 2\nrows: 2\n"


def test_a_python_system_splits_the_tick_and_changes_nothing() -> None:
    """Three calls instead of one; the same bits, random draws and scratch memory included."""
    results = []
    for compiled in (True, False):
        trade = kind("Trade", Toy, scratch=lambda self, name, dims: np.zeros(dims["rows"], np.float32))

        def swap(place: Write[Place], energy: Read[Energy], rows: Rows[Place], shelf: Scratch, key: Random) -> None:
            for e in rows:
                shelf[e] = place.x[e]
            for e in rows:
                place.x[e] = shelf[rows[rows.size - 1 - e]] + energy.left[e] * uniform(key, e)

        trade.system(Phase.MOVE, after="weather.blow", compiled=compiled)(swap)
        worlds = run(make(*toy_game.GAME, trade()), STEP, STEP, STEP)
        assert len(worlds.segments) == (1 if compiled or not COMPILED else 3)
        assert ("(python)" in str(worlds.schedule)) is not compiled
        results.append(digest(worlds))
    assert results[0] == results[1]


# ---- names that are nearly the same in the source of a tick


HP, Hp, Hp0, Hp_Hp0 = (
    type(name, (Component,), {"v": column("f8", fill=k)}) for k, name in enumerate(("HP", "Hp", "Hp0", "Hp_Hp0"), 1)
)


@dataclass(frozen=True)
class Alike(Toy):
    k: float = number(1000.0)
    K: float = number(5000.0)

    def archetypes(self) -> Any:
        return [Archetype("walker", (HP(), Hp(), Hp0())), Archetype("unlike", (Place(), Hp_Hp0()), 3)]


@Alike.system(Phase.FEED)
def read_all(
    one: Read[HP], two: Read[Hp], three: Read[Hp0], a: Rows[Hp, Hp0], b: Rows[Hp_Hp0], c: Rows[Hp, Hp0],
    place: Write[Place], k: float, K: float,  # noqa: N803
) -> None:  # fmt: skip
    e = a[0]
    place.x[e] = K + 100 * one.v[e] + 10 * two.v[e] + three.v[e]
    place.x[e + 1], place.x[e + 2] = 10 * a.size + c.size, k + b.size


@pytest.mark.parametrize("interpret", [(), ("alike.read_all",)])
def test_components_and_numbers_may_have_names_alike(interpret: tuple[str, ...]) -> None:
    worlds = run(Worlds([Walkers(), Alike()], 1, interpret=interpret), RESET, STEP)
    assert worlds[Place].x[0, worlds.span("walker")].tolist() == [5123, 33, 1003]


# ---- machine code on disk


def adder(amount: Callable[[], int]) -> Module:
    def act(energy: Add[Energy], rows: Rows[Energy]) -> None:
        for e in rows:
            energy.left[e] += np.int32(amount())

    return system_of(act)


def test_another_function_of_the_name_is_refused() -> None:
    enclosed = adder(kernel(lambda: 1))
    type(enclosed).system(Phase.FEED)(adder(kernel(lambda: 2)).registered[0].function)
    with pytest.raises(ScheduleError, match=r"two systems are called local\.act"):
        make(Walkers(), enclosed)


SCRIPT = """
import sys
import threading
sys.path[:0] = [{game!r}, {root!r}]
from {module} import STEP, make, run
worlds = run(make(count=40, threads=2), STEP, STEP)
from tests.conftest import digest
print(len(worlds.units.compiled + worlds._team.code.compiled), worlds.compiled, digest(worlds))
worlds.close()
"""


def in_process(cache: Path, game: Path = ROOT, module: str = "tests.helpers.toy_game", **variables: str) -> list[str]:
    """A new process and its first ticks: units compiled, cached now, digest."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    script = SCRIPT.format(game=str(game), root=str(ROOT), module=module)
    environment |= {"OUTLAST_CACHE_DIR": str(cache), **variables}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@compiled_only
def test_a_second_process_finds_the_machine_code_of_the_first(tmp_path: Path) -> None:
    first = in_process(tmp_path)
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.unit")}
    second = in_process(tmp_path)
    assert int(first[0]) == len(files)
    assert (first[1], second[:2]) == ("True", ["0", "True"])
    assert first[2] == second[2]
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.unit")} == files


STEPS = SimpleNamespace(length=1)


@kernel
def length() -> int:
    return STEPS_TAKEN


STEPS_TAKEN = 1


def test_a_constant_that_changes_in_a_running_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a cell of a notebook that sets it is run again: new worlds have the new one, old worlds the old."""
    local = adder(length)
    old = run(make(Walkers(), local), STEP)
    monkeypatch.setitem(globals(), "STEPS_TAKEN", 5)
    new = run(make(Walkers(), local), STEP)
    assert [int(worlds[Energy].left[0, 0]) - 20 for worlds in (old, new)] == [1, 5]
    if COMPILED:  # machine code that has the old one in it stays as it is
        run(old, STEP)
        assert int(old[Energy].left[0, 0]) - 20 == 2


def bare() -> int:
    return 1


def writing(expression: str) -> Callable[..., None]:
    """A system that writes the value of an expression."""
    names = {**globals(), "random": random}
    exec(f"def act(place: Write[Place], rows: Rows[Place]) -> None:\n    place.x[rows[0]] = {expression}", names)
    act: Callable[..., None] = names["act"]
    return act


@compiled_only
@pytest.mark.parametrize(
    ("expression", "named", "cure"),
    [
        ("STEPS.length", "STEPS, SimpleNamespace", "a number of the mechanic"),
        ("[toy_game][0].STEP", "toy_game, module", "toy_game.LIMIT"),
        ("bare()", r"bare, function test_compile\.py, line \d+:", "put @outlast.ecs.kernel above it"),
    ],
)
def test_references_that_cannot_be_followed_are_refused(expression: str, named: str, cure: str) -> None:
    with pytest.raises(DeclarationError, match=rf"local\.act refers to {named}.*{re.escape(cure)}"):
        make(Walkers(), system_of(writing(expression)))


@kernel
def draw() -> float:
    return float(np.random.normal())  # noqa: NPY002


GENERATOR = np.random.default_rng(0)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    "expression", ["np.random.random()", "(lambda: random.random())()", "draw()", "GENERATOR.random()"]
)
def test_generators_with_a_state_are_refused(expression: str, compiled: bool) -> None:
    """The same seed would not give the same bits. outlast.ecs.kernels.random is none of them."""
    local = kind("Local", Toy)
    with pytest.raises(DeclarationError, match=r"local\.act refers to .*the same seed.*ecs\.kernels\.random"):
        local.system(Phase.MOVE, compiled=compiled)(writing(expression))
    assert local.registered == []


@called_kernel
def seldom_needed(address: int, unused: int) -> int:
    return address + 1


@compiled_only
def test_functions_inside_machine_code_have_names_of_their_own() -> None:
    """LLVM takes arguments from them that nothing needs, and the loader would take them for numba's own copies."""

    def unit(address: int) -> None:
        if seldom_needed(address, 1) == 0:
            raise ValueError("an address is needed")

    code = compile_function(unit, OPTIONS)
    assert code.symbol.encode() in code.image
    assert b"seldom_needed" not in code.image
