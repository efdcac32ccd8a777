"""The processes that compile: each unit is compiled once, the work is spread, and no other process is touched."""

import contextlib
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from outlast.ecs.compilation import cache

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="others compile in one process")
PATIENCE = 60.0  # seconds until a test fails in which a process does not come


class Forks:
    """Work in processes on a pretended number of cores, which write into a log in `folder`.

    ended: statuses of forks that were waited for. killed: by id, whether a child got a signal that had not ended.
    """

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.folder, self._patch = folder, patch
        self._meeting, self._writing = os.pipe()
        self.ended, self.killed = list[int](), dict[int, bool]()
        wait, kill = os.waitpid, os.kill

        def waitpid(child: int, options: int) -> tuple[int, int]:
            found = wait(child, options)
            self.ended += [found[1]] if found[0] else []
            return found

        def checked_kill(child: int, number: int) -> None:
            if child != os.getpid():
                self.killed[child] = os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
            kill(child, number)

        patch.setattr(os, "waitpid", waitpid)
        patch.setattr(os, "kill", checked_kill)
        patch.setattr(threading, "active_count", lambda: 1)

    def spread(self, cores: int, work: Callable[[str], None]) -> None:
        """Spread four units for each core."""
        self._patch.setattr(cache, "_cores", lambda: cores)
        cache._spread([f"unit{k}" for k in range(4 * cores)], work)

    def log(self, label: str) -> None:
        """Write down that this process has done a unit."""
        with (self.folder / "log").open("a") as file:
            file.write(f"{os.getpid()} {label}\n")

    def done(self) -> list[list[str]]:
        return [line.split() for line in (self.folder / "log").read_text().splitlines()]

    def meet(self) -> None:
        """Wait until all processes that were forked since this object was made have come here once, or have ended."""
        if self._writing >= 0:
            os.close(self._writing)
            self._writing = -1
        assert os.read(self._meeting, 1) == b""

    def close(self) -> None:
        for end in (self._meeting, self._writing):
            if end >= 0:
                os.close(end)


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def has_ended(process: str) -> bool:
    try:
        return Path("/proc", process, "stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


@pytest.fixture
def forks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Forks]:
    with contextlib.closing(Forks(tmp_path, monkeypatch)) as made:
        yield made


def reap(*_: Any) -> None:
    """Wait for all children, as some handlers of SIGCHLD do."""
    with contextlib.suppress(ChildProcessError):
        while os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG):
            pass


@contextlib.contextmanager
def handled(number: int, handler: Any) -> Iterator[None]:
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


CHILDREN = {"this process": signal.SIG_DFL, "nobody": signal.SIG_IGN, "a handler": reap}


@pytest.mark.parametrize("waits", CHILDREN)
@pytest.mark.parametrize("cores", [2, 3, 4, 8, 64])
def test_each_unit_is_compiled_once_and_the_work_is_spread(forks: Forks, cores: int, waits: str) -> None:
    """Every core has a process, which does some of the work, and none fails, whoever waits for children."""

    def work(label: str) -> None:
        forks.meet()
        forks.log(label)

    with handled(signal.SIGCHLD, CHILDREN[waits]):
        forks.spread(cores, work)
    done = forks.done()
    assert sorted(label for _, label in done) == sorted(f"unit{k}" for k in range(4 * cores))
    assert len(Counter(process for process, _ in done)) == cores
    assert forks.ended == [0] * (cores - 1) or (waits != "this process" and not any(forks.ended))
    assert forks.killed == {}


@pytest.mark.parametrize("waits", CHILDREN)
def test_an_error_here_ends_the_forks_that_run_and_nothing_else(forks: Forks, waits: str) -> None:
    """One fork has ended before the error, the other ones run."""
    owner, first, begun = os.getpid(), forks.folder / "first", forks.folder / "begun"

    def work(label: str) -> None:
        if os.getpid() == owner:
            begun.touch()
            wait_for(lambda: first.is_symlink() and has_ended(os.readlink(first)))
            raise KeyError(label)
        with contextlib.suppress(FileExistsError):
            first.symlink_to(str(os.getpid()))
        wait_for(begun.exists)
        if os.readlink(first) == str(os.getpid()):
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(PATIENCE)

    with handled(signal.SIGCHLD, CHILDREN[waits]), pytest.raises(KeyError):
        forks.spread(4, work)
    assert [*forks.killed.values()] == [True, True]
    for fork in (*forks.killed, int(os.readlink(first))):
        with pytest.raises(ChildProcessError):  # somebody has waited for it
            os.waitpid(fork, os.WNOHANG)


def test_what_a_fork_fails_at_is_left_undone(forks: Forks) -> None:
    """All else is done; this process tries that unit itself, and raises the error."""
    owner, first = os.getpid(), forks.folder / "first"

    def work(label: str) -> None:
        forks.meet()
        if os.getpid() != owner:
            with contextlib.suppress(FileExistsError):
                first.symlink_to(label)
                raise KeyError(label)
        forks.log(label)

    forks.spread(3, work)
    assert {label for _, label in forks.done()} == {f"unit{k}" for k in range(12)} - {os.readlink(first)}
    assert sorted(os.waitstatus_to_exitcode(status) for status in forks.ended) == [0, 1]


def test_where_no_process_can_be_made_this_one_does_all(forks: Forks, monkeypatch: pytest.MonkeyPatch) -> None:
    def fork() -> int:
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", fork)
    forks.spread(4, forks.log)
    assert [label for _, label in forks.done()] == [f"unit{k}" for k in range(16)]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, -signal.SIGTERM), (signal.SIGUSR1, 0)])
def test_handlers_of_the_program_do_not_run_in_a_fork(forks: Forks, number: int, status: int) -> None:
    """SIGTERM ends the fork, and what would not end this process does not end it either."""
    owner = os.getpid()

    def work(label: str) -> None:
        forks.meet()
        if os.getpid() != owner:
            os.kill(os.getpid(), number)

    with handled(number, lambda *_: forks.log("handler")):
        forks.spread(2, work)
    assert [os.waitstatus_to_exitcode(status) for status in forks.ended] == [status]
    assert not (forks.folder / "log").exists()


def test_forks_end_after_their_parent_was_killed(forks: Forks) -> None:
    reading, writing = os.pipe()

    def work(label: str) -> None:
        forks.log(label)
        forks.meet()

    parent = cache._fork(lambda: forks.spread(3, work))
    os.close(writing)
    wait_for(lambda: (forks.folder / "log").exists() and len(forks.done()) == 3)
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)
    forks.meet()
    assert os.read(reading, 1) == b""  # when all have ended
    os.close(reading)
    assert len(forks.done()) == 3


@pytest.mark.parametrize(
    ("cores", "memory", "expected"),
    [(1, 9 * cache.FORK_MEMORY, 1), (64, 0, 1), (64, 3.9 * cache.FORK_MEMORY, 4), (64, float("inf"), 64)],
)
def test_memory_limits_the_processes(monkeypatch: pytest.MonkeyPatch, cores: int, memory: float, expected: int) -> None:
    monkeypatch.setattr(cache, "available_cores", lambda: cores)
    monkeypatch.setattr(cache, "available_memory", lambda: memory)
    assert cache._cores() == expected
