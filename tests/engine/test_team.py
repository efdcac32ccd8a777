"""Threads that share worlds: each world takes each tick once, whatever wakes up late, fails or is interrupted."""

import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast.ecs import Read, Singleton, Write, column, number
from outlast.ecs.kernels.jit import entry_point
from outlast.ecs.kernels.machine_code import atomic_add
from outlast.ecs.running.team import MIN_RANGE
from tests.conftest import COMPILED, digest, scaled
from tests.helpers.mechanics import kind
from tests.helpers.toy_game import STEP, Clock, Phase, Toy, Walkers, make, run, walked

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(not COMPILED, reason="uncompiled ticks run in the caller's thread")
MANY = 200

INTERRUPTED = """
import sys
from tests.conftest import digest
from tests.helpers.interruption import interrupt_after
from tests.helpers.toy_game import STEP, make, run

alone, worlds, after = make(count=100), make(count=100, threads=4), 0
team = worlds._team
while True:  # Ctrl-C comes after the next call in each round: there, Python looks for signals
    worlds.close()
    ready = False
    try:
        interrupt_after(after)
        team.ready()
        sys.setprofile(None)
        ready = True
    except KeyboardInterrupt:
        sys.setprofile(None)
    assert digest(run(worlds, STEP)) == digest(run(alone, STEP)), f"another result after Ctrl-C at event {after}"
    assert len(team._threads) == 3
    if ready:
        break
    after += 1
print(after)
"""


@entry_point
def add(address: int, times: int) -> None:
    for _ in range(times):
        atomic_add(address, 1)


def test_what_threads_add_is_the_sum() -> None:
    total, times = np.zeros(1, np.int64), scaled(1_000_000)
    threads = [threading.Thread(target=add, args=(total.ctypes.data, times)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert total[0] == 4 * times


class Count(Singleton):
    ticks: Any = column("i4")


Counting = kind("Counting", Toy, singletons=[Count()])  # a world counts its ticks


@Counting.system(Phase.FEED)
def add_one(count: Write[Count]) -> None:
    count.ticks[0] += 1


@pytest.mark.parametrize("pauses", [False, True], ids=["at once", "pauses"])
@pytest.mark.parametrize(("count", "threads"), [(MIN_RANGE + 1, 2), (50, 7), (1009, 3), (64, 64), (1009, 16)])
def test_each_world_takes_each_tick_once(count: int, threads: int, pauses: bool) -> None:
    worlds, rng = make(Walkers(), Counting(), count=count, threads=threads), np.random.default_rng(0)
    ticks = scaled(60 if pauses else 2000)
    before = worlds[Count].ticks[:, 0].copy()
    for _ in range(ticks):
        run(worlds, STEP)
        if pauses:
            time.sleep(rng.uniform(0, 0.002))
    assert (worlds[Count].ticks[:, 0] - before == ticks).all()
    worlds.close()


def test_interrupted_anywhere_a_team_can_begin_again() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], cwd=ROOT, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 10  # calls in `ready`


@dataclass(frozen=True)
class Fragile(Toy):
    """Raises in the world of a number, in its third tick."""

    world: int = number(0)


@Fragile.system(Phase.FEED)
def break_down(clock: Read[Clock], world: int) -> None:
    if clock.world[0] == world and clock.tick[0] == 3:
        raise ValueError("this world")


@pytest.mark.parametrize(("world", "count"), [(0, MANY), (77, MANY), (MANY - 1, MANY), (0, 1)])
def test_an_exception_in_one_thread_reaches_the_caller(world: int, count: int) -> None:
    worlds = make(Walkers(), Fragile(world), count=count, threads=min(count, 3))
    run(worlds, STEP, STEP)
    with pytest.raises(ValueError, match=r"fragile\.break_down \(test_team\.py, line \d+\): this world") as raised:
        run(worlds, STEP)
    (place,) = [note for note in raised.value.__notes__ if note.startswith("Raised in ")]
    first, last = [int(word) for word in place.replace(".", " ").split() if word.isdigit()][:2]
    assert first <= world <= last < count
    run(worlds, STEP)
    worlds.close()


@pytest.mark.parametrize("threads", [1, 3])
def test_interrupted_while_a_system_fails_the_next_tick_is_whole(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes when machine code has returned, before anybody has looked at what it says."""
    worlds = make(Walkers(), Fragile(MANY - 1), Counting(), count=MANY, threads=threads)
    run(worlds, STEP, STEP)

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("outlast.ecs.running.execution._exception", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(worlds, STEP)
    before = worlds[Count].ticks.copy()
    run(worlds, STEP)
    assert (worlds[Count].ticks == before + 1).all()
    worlds.close()


def test_without_such_threads_the_caller_does_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("outlast.ecs.running.team.has_symbol", lambda name: False)
    with pytest.warns(UserWarning, match="threads=3 has no effect: this system has no POSIX threads"):
        worlds = make(count=MANY, threads=3)
    assert digest(walked(worlds, 5)) == digest(walked(make(count=MANY), 5))
