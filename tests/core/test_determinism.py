"""The same seeds and actions give the same bits, however worlds are run."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, Scenario, variant
from outlast.ecs import Clock, Event
from tests.conftest import COMPILED, scaled
from tests.digests import behaviour_digests, numbered_actions
from tests.helpers.execution_modes import FEW, ExecutionMode, lockstep, short

ROOT = Path(__file__).parents[2]
QUICK = ("teams_4",)  # variants of the fast tests


@pytest.mark.parametrize(
    ("scenario", "ticks"),
    [
        (short("teams_4"), scaled(100, least=8)),
        # With the paper's own numbers, several episodes, and machine code for one layout, compiled for this test.
        *(pytest.param(variant(name), scaled(2000, least=40), marks=pytest.mark.nightly) for name in VARIANTS),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_same_bits_however_worlds_are_run(scenario: Scenario, ticks: int) -> None:
    lockstep(scenario, ticks, specialize=ticks > 100)


def test_digests_are_of_every_column() -> None:
    """Guards the tests above against a digest that is blind, and against comparing one episode only."""
    mode = ExecutionMode(short("teams_4"), range(FEW))
    for tick in range(scaled(100, least=8)):
        mode.step(numbered_actions(mode.env, tick))
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


@pytest.mark.parametrize(
    ("names", "ticks"),
    [(QUICK, scaled(200, least=1)), pytest.param(VARIANTS, scaled(2000, least=10), marks=pytest.mark.nightly)],
)
def test_another_process_observes_the_same(names: Sequence[str], ticks: int) -> None:
    """Its hashes of strings are others, and its worlds are shared out to threads."""
    command = [sys.executable, "-m", "tests.digests", *names, "--ticks", str(ticks), "--threads", "2"]
    found = subprocess.check_output(command, cwd=ROOT, env=os.environ | {"PYTHONHASHSEED": "7"}, text=True)
    assert json.loads(found) == {name: behaviour_digests(name, ticks) for name in names}


PLAIN = """
import sys
import numpy as np
from tests.core.test_determinism import watched
from tests.helpers.sines import sines_of_c

with sines_of_c():
    np.savez(sys.argv[1], **watched(sys.argv[2]))
"""


def watched(name: str) -> dict[str, np.ndarray[Any, Any]]:
    mode = ExecutionMode(short(name), range(2))
    rows: dict[str, list[Any]] = {}
    for tick in range(70):
        observations, reward, terminated, truncated, _ = mode.env.step(numbered_actions(mode.env, tick))
        outcome = {**observations, "reward": reward, "terminated": terminated, "truncated": truncated}
        for key, array in outcome.items():
            rows.setdefault(key, []).append(array.copy())
    return {key: np.stack(arrays) for key, arrays in rows.items()}


@pytest.mark.skipif(not COMPILED, reason="compares compiled kernels with plain Python")
@pytest.mark.skipif(sys.platform == "win32", reason="sinf is in no library of the process itself")
def test_plain_python_gives_the_same_bits_with_the_sines_of_the_c_library(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PLAIN, tmp_path / "observed.npz", *QUICK]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, check=True)
    with np.load(tmp_path / "observed.npz") as there:
        found = {key: array.tobytes() for key, array in there.items()}
    assert found == {key: array.tobytes() for key, array in watched(*QUICK).items()}
