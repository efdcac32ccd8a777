"""Many worlds at once: each gets what it would have alone, and errors and Ctrl-C leave no thread at work."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from outlast.ecs import Worlds
from outlast.ecs.workers import Job, Workers
from tests.conftest import COMPILED, digest, scaled
from tests.toy import (
    RESET,
    STEP,
    Food,
    Walkers,
    Weather,
    make,
    run,
    walked,
)

threaded = pytest.mark.skipif(not COMPILED, reason="uncompiled ticks run in the caller's thread")
MANY = scaled(200, least=40)  # more than a thread takes at a time


def test_a_world_among_many_is_what_it_is_alone() -> None:
    batch = walked(make(count=64), 10)
    for w in (0, 1, 31, 63):
        assert digest(walked(make(count=1, first=w), 10)) == digest(batch, slice(w, w + 1))
    part = walked(make(count=7, first=20), 10)
    assert digest(part) == digest(batch, slice(20, 27))


@pytest.mark.parametrize("threads", [2, 3, 5])
def test_threads_give_the_same_bits(threads: int) -> None:
    worlds = make(count=MANY, threads=threads)
    assert digest(walked(worlds, 20)) == digest(walked(make(count=MANY), 20))
    worlds.close()
    worlds.close()
    assert digest(run(worlds, STEP)) != ""  # after close the threads come back when needed
    worlds.close()


@threaded
def test_scratch_memory_belongs_to_one_thread() -> None:
    """The toy's Weather counts in it the ticks that its thread has seen: together, each world's once."""
    made: list[Any] = []

    class Gale(Weather):
        name = "weather"

        def scratch(self, name: str, dims: dict[str, int]) -> Any:
            made.append(super().scratch(name, dims))
            return made[-1]

    worlds = Worlds([Walkers(), Food(), Gale()], MANY, 3)
    made.clear()  # one was made to learn its type
    run(worlds, RESET, STEP, STEP)
    worlds.close()
    assert 1 <= len(made) <= 3
    assert sum(memory[0, 0] for memory in made) == 2 * MANY
    assert len({memory.ctypes.data for memory in made}) == len(made)


def test_an_error_in_one_thread_reaches_the_caller() -> None:
    """And the worlds go on afterwards."""
    worlds = make(count=MANY, threads=3)
    call, name = worlds._call, threading.current_thread().name

    def fail(*arguments: Any) -> None:
        raise RuntimeError(f"not in {name}")

    worlds._call = fail  # type: ignore[method-assign]
    with pytest.raises(RuntimeError, match="not in"):
        run(worlds, STEP)
    worlds._call = call  # type: ignore[method-assign]
    run(worlds, STEP)
    worlds.close()


@threaded
def test_interrupted_while_threads_begin_leaves_none_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in `submit`, when a thread has begun."""
    worlds, submit, running = make(count=MANY, threads=3), Workers.submit, []
    call = worlds._call

    def slowly(*arguments: Any) -> None:
        running.append(True)
        time.sleep(0.2)
        call(*arguments)
        running.pop()

    def interrupted(workers: Workers, jobs: list[Job]) -> None:
        submit(workers, jobs)
        while not running:
            time.sleep(0.001)
        raise KeyboardInterrupt

    worlds._call = slowly  # type: ignore[method-assign]
    with monkeypatch.context() as patch:
        patch.setattr(Workers, "submit", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(worlds, STEP)
    assert not running
    worlds._call = call  # type: ignore[method-assign]
    run(worlds, [RESET] * MANY, STEP)
    worlds.close()


def test_several_python_threads_may_run_worlds_of_their_own() -> None:
    expected = digest(walked(make(count=MANY), 10))

    def play(threads: int) -> str:
        worlds = make(count=MANY, threads=threads)
        found = digest(walked(worlds, 10))
        worlds.close()
        return found

    with ThreadPoolExecutor(6) as pool:
        assert set(pool.map(play, [1, 2, 3, 1, 2, 3])) == {expected}
