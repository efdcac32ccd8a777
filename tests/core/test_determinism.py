"""The same seeds and actions give the same bits, however worlds are run."""

import functools
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, variant
from outlast.ecs import Clock, Event
from tests.conftest import COMPILED, scaled
from tests.digests import behaviour_digests, numbered_actions
from tests.helpers.execution_modes import FEW, SHORT, ExecutionMode, first_difference, lockstep, short

ROOT = Path(__file__).parents[2]
QUICK = ("teams_4",)  # variants of the fast tests


@pytest.mark.parametrize("name", QUICK)
def test_the_same_bits_however_worlds_are_run(name: str) -> None:
    """By night with machine code for one layout, too, which would be compiled for this test."""
    lockstep(short(name), scaled(100, least=8), specialize=False)


@pytest.mark.nightly
@pytest.mark.parametrize("name", VARIANTS)
def test_the_same_bits_for_two_thousand_ticks(name: str) -> None:
    """With the paper's own numbers, and several episodes in every world."""
    lockstep(variant(name), scaled(2000, least=40))


def test_the_two_backends_agree_in_a_crowd() -> None:
    """Contacts are many; boxes are set up on top of agents."""
    crowd = variant("teams_3").replace(**SHORT | {"n_agents": 12, "agents_health": 40, "room_size": 26.0})
    backends = ("native", "portable") if COMPILED else ("auto", "portable")
    native, portable = (ExecutionMode(crowd.replace(physics_backend=backend), range(8)) for backend in backends)
    assert "(python)" in str(portable.env.worlds.schedule)
    assert ("(python)" in str(native.env.worlds.schedule)) == (not COMPILED)
    for tick in range(scaled(150, least=10)):
        actions = numbered_actions(native.env, tick)
        native.step(actions)
        portable.step(actions)
        assert native.digest() == portable.digest(), f"tick {tick}: {first_difference(native, portable)}"


def test_every_mode_sees_episodes_end() -> None:
    """Guards the tests above against comparing one episode only, and against a digest that is blind."""
    mode = ExecutionMode(short("teams_4"), range(FEW))
    seen = set()
    for tick in range(scaled(100, least=8)):
        mode.step(numbered_actions(mode.env, tick))
        seen.add(mode.digest())
    assert len(seen) == scaled(100, least=8)
    assert mode.env.worlds[Clock].episode.min() >= (2 if COMPILED else 0)
    before = mode.digest()
    for component in mode.env.worlds.components:
        table = mode.env.worlds[component]
        for column in table[-1:] if issubclass(component, Event) else table:  # behind the last event nothing counts
            if column.size:
                column.view(np.uint8)[0].flat[-1] ^= 1
                assert mode.digest() != before, component
                column.view(np.uint8)[0].flat[-1] ^= 1
    assert mode.digest() == before


@functools.cache
def digests_of(name: str, ticks: int) -> dict[str, str]:
    return behaviour_digests(name, ticks)


def in_another_process(names: Sequence[str], ticks: int, **environment: str) -> Any:
    """The digests of another process, whose hashes of strings are others and whose worlds are shared out to threads."""
    command = [sys.executable, "-m", "tests.digests", *names, "--ticks", str(ticks), "--threads", "2"]
    variables = os.environ | {"PYTHONHASHSEED": "7"} | environment
    return json.loads(subprocess.check_output(command, cwd=ROOT, env=variables, text=True))


def test_another_process_observes_the_same() -> None:
    ticks = scaled(200, least=1)
    assert in_another_process(QUICK, ticks) == {name: digests_of(name, ticks) for name in QUICK}


@pytest.mark.nightly
def test_another_process_observes_the_same_for_two_thousand_ticks() -> None:
    ticks = scaled(2000, least=10)
    assert in_another_process(VARIANTS, ticks) == {name: digests_of(name, ticks) for name in VARIANTS}


PLAIN = """
import sys
import numpy as np
from tests.core.test_determinism import watched
from tests.helpers.sines import sines_of_c

with sines_of_c():
    np.savez(sys.argv[1], **watched(sys.argv[2]))
"""


def watched(name: str) -> dict[str, np.ndarray[Any, Any]]:
    """Observations and rewards of two short worlds, a row a tick."""
    mode = ExecutionMode(short(name), range(2))
    rows: dict[str, list[Any]] = {}
    for tick in range(70):
        observations, reward, terminated, truncated, _ = mode.env.step(numbered_actions(mode.env, tick))
        outcome = {**observations, "reward": reward, "terminated": terminated, "truncated": truncated}
        for key, array in outcome.items():
            rows.setdefault(key, []).append(array.copy())
    return {key: np.stack(arrays) for key, arrays in rows.items()}


def as_plain_python(name: str, file: Path) -> dict[str, np.ndarray[Any, Any]]:
    """The same from kernels that are not compiled, with the sines of libm."""
    variables = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", PLAIN, str(file), name]
    subprocess.run(command, cwd=ROOT, env=variables, check=True)
    with np.load(file) as arrays:
        return dict(arrays)


@pytest.mark.skipif(not COMPILED, reason="compares compiled kernels with plain Python")
@pytest.mark.skipif(sys.platform == "win32", reason="sinf is in no library of the process itself")
def test_plain_python_gives_the_same_bits_with_the_sines_of_the_c_library(tmp_path: Path) -> None:
    """Nothing else differs: neither order of operations, nor a fused multiply and add, nor a rounding."""
    for name in QUICK:
        here, there = watched(name), as_plain_python(name, tmp_path / "observed.npz")
        assert {key: array.tobytes() for key, array in here.items()} == {k: a.tobytes() for k, a in there.items()}
