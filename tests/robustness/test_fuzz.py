"""Hostile files for each loader, and random scenarios, of seeds that hypothesis chooses.

A hostile file is a valid one in which something has been changed: bits, pieces, headers, archive entries, or numbers
under a correct checksum. A loader refuses it with its own exception, or returns something that works; each file may
take MEMORY on top of what the process has, and a minute. OUTLAST_FUZZ=100 makes a hundred times as many,
OUTLAST_FUZZ_SEED others. A crash leaves its file as "PROCESS hostile.file" among temporary files; with
NUMBA_BOUNDSCHECK=1, an index out of range in a kernel is an error, too.
"""

import contextlib
import faulthandler
import importlib
import importlib.util
import json
import mmap
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from outlast.envs.errors import StateError

MORE, SEED = int(os.environ.get("OUTLAST_FUZZ", "1")), int(os.environ.get("OUTLAST_FUZZ_SEED", "1"))
MEMORY = 1500 * 2**20  # bytes
FILES = {
    "worlds.States": 150, "worlds.LevelStates": 100, "worlds.Recordings": 40, "levels.Plans": 400, "levels.Levels": 300,
    "levels.Games": 60, "levels.RoleFiles": 100, "training.Checkpoints": 30, "training.Policies": 60,
    "training.Results": 120,
}  # fmt: skip
NEEDED = ("torch", "tensorboard", "matplotlib")  # by the loaders of training
PLAIN = settings(deadline=None, database=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))


@contextlib.contextmanager
def limited(memory: int) -> Iterator[None]:
    """At most so many bytes more than this process has, and a minute."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + memory, before[1]))
    faulthandler.dump_traceback_later(60, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, before)


def refuses(target: Any, path: Path) -> bool:
    """Whether a loader refuses a file, and not for lack of memory."""
    try:
        with limited(MEMORY):
            target.use(path)
    except target.refusals as error:
        if isinstance(error.__cause__ or error.__context__, MemoryError):
            raise AssertionError("it needs too much memory") from error
        return True
    return False


@pytest.mark.timeout(0 if MORE > 1 else 300)
@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("loader", FILES)
@pytest.mark.by_day(4)
def test_hostile_files_are_refused_or_work(loader: str, times: int) -> None:
    """Some must be accepted, or nothing behind loading is tested."""
    module, _, name = loader.partition(".")
    for library in NEEDED if module == "training" else ():
        pytest.importorskip(library)
    target = getattr(importlib.import_module(f"tests.fuzz.{module}"), name)()
    path, found = Path(tempfile.gettempdir(), f"{os.getpid()} hostile.file"), Counter[bool]()
    path.write_bytes(target.valid)
    target.use(path)

    @seed(SEED + times)
    @settings(PLAIN, max_examples=FILES[loader] * times * MORE)
    @given(st.integers(0, 2**64 - 1))
    def use(number: int) -> None:
        path.write_bytes(target.mutate(Random(number)))
        found[refuses(target, path)] += 1

    use()
    path.unlink()
    assert 0.2 < found[True] / found.total() < 0.95


def test_greed_is_an_error(tmp_path: Path) -> None:
    def greedy(path: Path) -> None:
        try:
            np.zeros(2**33, np.uint8)
        except MemoryError as error:
            raise StateError from error

    with pytest.raises(AssertionError, match="too much memory"):
        refuses(SimpleNamespace(use=greedy, refusals=(StateError,)), tmp_path)


@pytest.mark.nightly
@pytest.mark.timeout(0)
def test_random_scenarios_run_equally_or_are_refused() -> None:
    """Compiled and as plain Python, with the same digests; what is refused is printed for a person to judge."""
    words = [sys.executable, "-X", "faulthandler", "-m", "tests.fuzz.scenarios", str(SEED), str(12 * MORE), "60"]
    both = list[list[dict[str, Any]]]()
    for plain in ("0", "1"):
        done = subprocess.run(words, env=os.environ | {"NUMBA_DISABLE_JIT": plain}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-3000:]
        both.append([json.loads(line) for line in done.stdout.splitlines()])
    for k, pair in enumerate(zip(*both, strict=True)):
        assert not any("error" in result for result in pair), (k, pair)
        assert all(one == two for one, two in zip(*(result["digests"] for result in pair), strict=False)), k
        one, two = (re.split("; did you mean|;? In phase ", result.get("refused", ""))[0] for result in pair)
        assert one == two, k
    refused = [result.get("refused", "") for result in both[0]]
    print(*sorted({re.sub(r"\d", "#", message) for message in refused}), sep="\n")
    assert 12 * MORE == len(refused) > sum(map(bool, refused))
