"""How kernels run: as Python within a compiled process, with the same bits; and with checks of their indices."""

import os
import re
import subprocess
import sys
from collections.abc import Collection
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from outlast import Scenario
from outlast.components import Body, Health, Phase, Side
from outlast.ecs import DeclarationError, Module, Read, Rows, ScheduleError, Statistic, Worlds, Write, column, kernel
from outlast.ecs.checks.trial import python_refusal
from outlast.ecs.compilation.cache_key import CacheKey
from outlast.ecs.kernels import jit
from outlast.ecs.kernels.jit import interpreted, loader, storer
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, store, to_bits, trailing_zeros
from outlast.ecs.memory.episode import RESET, STEP
from outlast.systems import Physics
from outlast.systems.box2d import layout as box2d
from tests.conftest import COMPILED, digest
from tests.helpers import toy_game
from tests.helpers.execution_modes import short
from tests.helpers.mechanics import duel, idle, kind
from tests.helpers.sines import sines_of_c
from tests.helpers.toy_game import Place

TICKS = 40
compiled_only = pytest.mark.skipif(not COMPILED, reason="compares with machine code")


def play(scenario: Scenario, interpret: Collection[str] = ()) -> list[str]:
    """Digests of two worlds after each tick."""
    worlds = Worlds(scenario.modules, 2, interpret=interpret)
    worlds.seed(3, np.arange(2))
    rng, digests = np.random.default_rng(5), []
    with sines_of_c() if interpret else nullcontext():
        for tick in range(TICKS):
            worlds.actions[:] = rng.integers(0, 2, worlds.actions.shape)
            worlds.run(np.full(2, STEP if tick % 30 else RESET, np.int8))
            digests.append(digest(worlds))
    return digests


@compiled_only
@pytest.mark.parametrize("threads", [1, 3])
def test_single_systems_run_as_python(capsys: pytest.CaptureFixture[str], threads: int) -> None:
    """With Python's own print and errors, among others that stay machine code."""

    def act(place: Read[Place], rows: Rows[Place]) -> None:
        print("rows", rows.size)
        if place.x[rows[0]] < -1000:
            raise KeyError("far away")

    worlds = Worlds((*toy_game.GAME, toy_game.system_of(act)), 40, threads, interpret=["local.act", "walkers.walk"])
    toy_game.run(worlds, RESET, STEP)
    assert {segment.compiled for segment in worlds.segments} == {True, False}
    assert capsys.readouterr().out.count("rows ") == 40  # machine code prints past Python's stdout
    worlds[Place].x[:] = -5000
    with pytest.raises(KeyError, match="far away") as caught:
        toy_game.run(worlds, STEP)
    assert caught.traceback[-1].name == "act"
    worlds.close()


@compiled_only
def test_some_systems_as_python_give_the_same_bytes() -> None:
    compiled = play(short("ffa_1"))  # first, as nothing may be compiled in `sines_of_c`
    assert play(short("ffa_1"), ["motors.drive", "melee.aim", "pickup.pick_up"]) == compiled


def test_an_unknown_system_cannot_be_interpreted() -> None:
    with pytest.raises(ScheduleError, match=r"unknown system 'walkers.wlak'; did you mean walkers.walk"):
        Worlds(toy_game.GAME, 1, interpret=["walkers.wlak"])


@kernel
def lanes(column: Any, flags: Any, out: Any) -> int:
    store(out, 0, load(column, 0) + load(column, 0))
    return int(trailing_zeros(to_bits(load_flags(flags, 0))))


def test_simd_can_be_called_from_python() -> None:
    column, flags = np.arange(SIMD_WIDTH, dtype=np.float32), np.zeros(SIMD_WIDTH, np.uint8)
    flags[5:] = 1
    results = []
    for python in (False, True):
        out = np.zeros(SIMD_WIDTH, np.float32)
        if python:
            with interpreted():
                results.append((lanes(column, flags, out), out.tolist()))
        else:
            results.append((lanes(column, flags, out), out.tolist()))
    assert results == [(5, (2 * column).tolist())] * 2
    assert to_bits(load(column, 0) > 3) == 0xFFF0


@kernel
def seen() -> int:
    return FROZEN


FROZEN = 1


@compiled_only
def test_kernels_run_as_python_within_interpreted_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code keeps the constant that it was compiled with."""
    assert seen() == 1
    monkeypatch.setitem(globals(), "FROZEN", 2)
    with interpreted():
        assert seen() == 2
    assert seen() == 1


def test_loads_and_stores_at_an_address() -> None:
    for dtype in ("float32", "int32", "intp", "uint16", "uint8"):
        memory = np.zeros(3, dtype)
        storer(dtype)(memory.ctypes.data + memory.itemsize, 7)
        assert memory.tolist() == [0, 7, 0]
        value = loader(dtype)(memory.ctypes.data + memory.itemsize)
        assert (value, value.dtype) == (7, memory.dtype)


REFUSED = r'only machine code can call the C function .*; take physics_backend="portable"'


def test_the_native_backend_is_not_for_python() -> None:
    with pytest.raises(DeclarationError, match=REFUSED):
        box2d.sincos(0.0, 0, 0)
    for system in Module.imported_systems():
        native = system.label == "physics.collide" and system.compiled
        assert bool(re.fullmatch(REFUSED, python_refusal(system))) is native
    if COMPILED:  # else the portable backend is taken
        with pytest.raises(DeclarationError, match=rf"^physics\.collide cannot run as Python: {REFUSED}"):
            Worlds(short("ffa_1").modules, 1, interpret=["physics.collide"])


def reaches_out(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e + 100_000] = 0


@kernel
def far(place: Any, e: int) -> Any:
    return place.x[e + 100_000]


def test_a_kernel_that_python_calls_checks_its_indices() -> None:
    with pytest.raises(IndexError):
        far(Place.Table(np.zeros(3, np.float32), np.zeros((3, 2), np.int16)), 0)


@compiled_only
def test_bounds_checks_can_be_switched_off_and_are_part_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = []
    for checks in (True, False):
        monkeypatch.setattr(jit, "BOUNDS_CHECKS", checks)
        (system,) = toy_game.system_of(reaches_out).registered
        assert bool(system.kernel.targetoptions["boundscheck"]) is checks
        keys.append(CacheKey({system.label: system.kernel}).key(system.label, ""))
    assert keys[0] != keys[1]
    assert not any(system.kernel.targetoptions["boundscheck"] for system in Physics.registered if system.compiled)


@pytest.mark.skipif(not COMPILED, reason="about machine code")
@pytest.mark.parametrize(("value", "checks"), [("0", "False"), ("1", "True"), (None, "True")])
@pytest.mark.by_day(1)
def test_the_variable_that_switches_bounds_checks_off(value: str | None, checks: str) -> None:
    variables = {key: text for key, text in os.environ.items() if key != "OUTLAST_BOUNDSCHECK"}
    variables |= {"OUTLAST_BOUNDSCHECK": value} if value else {}
    command = [sys.executable, "-c", "from outlast.ecs.kernels import jit; print(jit.BOUNDS_CHECKS)"]
    output = subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout
    assert output.strip() == checks


class Sums(Statistic):
    least: Any = column("f8")
    middle: Any = column("f8")
    total: Any = column("f8")
    healthy: Any = column("i4")


Gathers = kind("Gathers", singletons=[Sums()])


@Gathers.system(Phase.MELEE, before=Health)
def gather(sums: Write[Sums], health: Write[Health], body: Read[Body], agents: Rows[Side]) -> None:
    health.points[agents] -= 1
    sums.least[0] += np.sort(body.x[agents])[0] + body.x[agents].min()
    sums.middle[0] += health.points[agents].mean() + np.clip(body.x[:4], -1, 1).sum()
    sums.total[0] += body.y[agents].sum() + body.x[:4].copy().sum()
    sums.healthy[0] += int(np.argmin(body.x[agents])) + int((health.points[agents] > 50).sum())


def test_rows_can_be_gathered_copied_and_sorted() -> None:
    """numpy's ways to take several rows at once: compiled and as Python."""
    found = []
    for interpret in ((), ("gathers.gather",)):
        env = duel(Gathers(), count=2, interpret=interpret)
        for _ in range(5):
            env.step(idle(env))
        found.append([np.array(values) for values in env.worlds[Sums]])
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-6)
        assert one.any()
