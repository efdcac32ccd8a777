"""How kernels run: as Python within a compiled process, with the same bits; and with checks of their indices."""

import os
import re
import subprocess
import sys
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from outlast.ecs import DeclarationError, Module, Read, Rows, ScheduleError, Worlds, Write, kernel
from outlast.ecs.checks.trial import python_refusal
from outlast.ecs.compilation.cache_key import CacheKey
from outlast.ecs.kernels import jit
from outlast.ecs.kernels.jit import interpreted
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, store, to_bits, trailing_zeros
from outlast.ecs.memory.episode import RESET, STEP
from outlast.systems import Physics
from outlast.systems.box2d import layout as box2d
from tests.conftest import COMPILED, compiled_only
from tests.helpers import toy_game
from tests.helpers.execution_modes import short
from tests.helpers.toy_game import Energy, Place, Wind


@compiled_only
@pytest.mark.parametrize("threads", [1, 3])
def test_single_systems_run_as_python(capsys: pytest.CaptureFixture[str], threads: int) -> None:
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
    for context in (nullcontext(), interpreted()):
        out = np.zeros(SIMD_WIDTH, np.float32)
        with context:
            assert (lanes(column, flags, out), out.tolist()) == (5, (2 * column).tolist())
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


@compiled_only
@pytest.mark.parametrize(("value", "checks"), [("0", "False"), ("1", "True"), (None, "True")])
@pytest.mark.by_day(1)
def test_the_variable_that_switches_bounds_checks_off(value: str | None, checks: str) -> None:
    variables = {key: text for key, text in os.environ.items() if key != "OUTLAST_BOUNDSCHECK"}
    variables |= {"OUTLAST_BOUNDSCHECK": value} if value else {}
    command = [sys.executable, "-c", "from outlast.ecs.kernels import jit; print(jit.BOUNDS_CHECKS)"]
    output = subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout
    assert output.strip() == checks


def gather(wind: Write[Wind], energy: Write[Energy], place: Read[Place], rows: Rows[Energy]) -> None:
    energy.left[rows] -= 1
    wind.push[0] = np.sort(place.x[rows])[0] + place.x[rows].min() + energy.left[rows].mean()
    wind.push[0] += np.clip(place.x[:4], -1, 1).sum() + place.x[:4].copy().sum()
    wind.push[0] += np.argmin(place.x[rows]) + (energy.left[rows] > 10).sum()


def test_rows_can_be_gathered_copied_and_sorted() -> None:
    game, found = (*toy_game.GAME, toy_game.system_of(gather, after=(Energy, Wind))), []
    for interpret in ((), ("local.gather",)):
        found.append(toy_game.run(Worlds(game, 2, interpret=interpret), RESET, STEP)[Wind].push.copy())
    np.testing.assert_allclose(*found, rtol=1e-6)
