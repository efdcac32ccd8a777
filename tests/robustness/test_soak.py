"""Long play, resets of all kinds, and environments that come and go: all holds, and nothing is left behind.

OUTLAST_SOAK=1 is the long run of docs/reliability.md; by night, a hundredth of it runs, where memory may still grow.
"""

import gc
import mmap
import os
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import VARIANTS
from tests.conftest import draw_actions
from tests.helpers.invariants import SCENARIOS, CheckedPlay, scenario

SHARE = float(os.environ.get("OUTLAST_SOAK", "0.01"))
PROC, MEGABYTE = Path("/proc/self"), 2**20
PROBES = 40  # measurements behind the first fifth of the work
WORLDS = 512  # of an environment that is stepped by two threads
Array = np.ndarray[Any, Any]


def steps() -> Iterator[int]:
    """Step worlds of all scenarios in turn, checking all invariants. Yields world-steps."""
    walks = [CheckedPlay(outlast.make_vec(scenario(name), WORLDS, seed=0, threads=2), seed=1) for name in SCENARIOS]
    while True:
        for walk in walks:
            walk.step()
            yield WORLDS


def resets() -> Iterator[int]:
    """Reset all or some worlds with every kind of seed, and step once after each reset. Yields resets."""
    rng, modes = np.random.default_rng(0), ("NextStep", "SameStep", "Disabled")
    envs = [outlast.make_vec(name, 3, seed=0, autoreset_mode=modes[k % 3]) for k, name in enumerate(VARIANTS)]
    for env in envs:
        env.reset()
    while True:
        for env in envs:
            mask = rng.random(3) < 0.5
            mask[rng.integers(3)] = True
            seed: Any = [None, int(rng.integers(2**63)), rng.integers(0, 2**63, 3)][rng.integers(3)]
            env.reset(seed=seed, options={"reset_mask": mask} if rng.random() < 0.5 else None)
            env.step(draw_actions(env, rng))
            yield 1


def environments() -> Iterator[int]:
    """Make environments with threads, and drop them, closed once, twice or not. Yields environments."""
    rng = np.random.default_rng(0)
    while True:
        for name in VARIANTS:
            env = outlast.make_vec(name, 40, seed=0, threads=3)
            env.reset()
            env.step(draw_actions(env, rng))
            env.send(draw_actions(env, rng))
            env.recv()
            for _ in range(rng.integers(3)):
                env.close()
            del env
            yield 1


def used() -> tuple[float, int, int]:
    """Resident megabytes, open files and threads of this process."""
    gc.collect()
    pages = int((PROC / "statm").read_text().split()[1])
    return pages * mmap.PAGESIZE / MEGABYTE, len(list((PROC / "fd").iterdir())), len(sys._current_frames())


def growth(make: Callable[[], Iterator[int]], amount: float) -> Array:
    """How much more is used at the end of the work than after a fifth of it: medians of a quarter of the probes."""
    done, found, places = 0, [], list(np.linspace(0.2 * amount, amount, PROBES))
    gc.collect()
    gc.freeze()  # existing objects, mostly the compiler's, make collecting slow
    for part in make():
        done += part
        if done >= places[0]:
            places = [place for place in places if place > done]
            found.append(used())
        if not places:
            break
    gc.unfreeze()
    quarter = -(-len(found) // 4)
    grown: Array = np.median(found[-quarter:], 0) - np.median(found[:quarter], 0)
    return grown


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.skipif(not PROC.exists(), reason="only Linux says what a process uses")
@pytest.mark.parametrize(("work", "amount"), [(steps, 10e6), (resets, 100_000), (environments, 1000)])
def test_a_soak_leaves_nothing_behind(work: Any, amount: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a process of its own, as memory that others have freed would hide growth."""
    monkeypatch.setenv("MALLOC_ARENA_MAX", "1")  # else the C library keeps an arena for each thread
    with get_context("spawn").Pool(1) as pool:
        memory, files, threads = pool.apply(growth, (work, max(8, SHARE * amount)))
    assert (files, threads) == (0, 0)
    assert memory < (1 if SHARE >= 0.1 else 100)


def objects() -> list[int]:
    """How many there are in this process after all variants were made and played, three times over."""
    work, counts = environments(), []
    for _ in range(3):
        for _ in range(len(VARIANTS)):
            next(work)
        gc.collect()
        counts.append(len(gc.get_objects()))
    return counts


@pytest.mark.nightly
def test_environments_leave_no_objects_behind() -> None:
    """In a process of its own, as tests before this one leave some that go when they like."""
    with get_context("spawn").Pool(1) as pool:
        counts = pool.apply(objects)
    assert counts[2] - counts[1] < 20


@pytest.mark.nightly
@pytest.mark.skipif(not PROC.exists(), reason="only Linux says what a process uses")
def test_leaks_are_noticed() -> None:
    kept = list[tuple[mmap.mmap, int, threading.Event]]()

    def leaking() -> Iterator[int]:
        while True:
            kept.append((mmap.mmap(-1, 2**16), os.open(os.devnull, os.O_RDONLY), threading.Event()))
            kept[-1][0].write(b"1" * 2**16)  # pages of its own: malloc may reuse those of other tests
            threading.Thread(target=kept[-1][2].wait).start()
            yield 1

    grown = growth(leaking, 40)
    for pages, file, ended in kept:
        pages.close()
        os.close(file)
        ended.set()
    assert (grown >= 1).all()
