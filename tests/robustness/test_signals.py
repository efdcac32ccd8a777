"""Ctrl-C where something has to be done whole; SIGTERM and SIGHUP, which are Ctrl-C to a command; SIGUSR1."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from outlast.envs.errors import FilmError
from outlast.envs.rendering.films import _ffmpeg
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.storage.interrupts import children_awaited, ignored, interrupts_held, save_requests, stops_as_ctrl_c
from tests.conftest import interrupted_after, run

STOPS = (signal.SIGTERM, signal.SIGHUP) if sys.platform != "win32" else ()
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Every test begins with the usual handlers, though nohup ignores SIGHUP, and leaves them as they were."""
    usual: dict[int, Any] = dict.fromkeys((*STOPS, signal.SIGUSR1), signal.SIG_DFL)
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    usual[signal.SIGINT] = signal.getsignal(signal.SIGINT)
    yield
    now = {number: signal.getsignal(number) for number in usual}
    for number, handler in before.items():
        signal.signal(number, handler)
    signal.signal(signal.SIGINT, usual[signal.SIGINT])
    assert now == usual


@pytest.mark.parametrize(
    ("number", "held"), [(signal.SIGINT, contextlib.nullcontext)] + [(n, stops_as_ctrl_c) for n in STOPS]
)
def test_signals_wait_for_what_has_to_be_whole(number: int, held: Callable[[], Any]) -> None:
    done = []

    def work() -> None:
        with held(), interrupts_held():
            signal.raise_signal(number)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [1]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), *((number, 128 + number) for number in STOPS)])
def test_a_command_prints_what_there_is(
    capsys: Any, tmp_path: Path, monkeypatch: Any, number: int, status: int
) -> None:
    monkeypatch.setitem(POLICIES, "noop", interrupted_after(30, number))
    table = tmp_path / "events.csv"
    words = ("rollout", "ffa_2", "--worlds=2", "--policy=noop", "--steps=60", "--quiet", "--events", table)
    code, out, err = run(capsys, *words)
    assert (code, err) == (status, "")
    assert "60 world-steps" in out
    assert table.read_text(encoding="utf-8").startswith("world,")


@pytest.mark.parametrize("number", [*STOPS, signal.SIGUSR1])
def test_what_a_command_is_told_to_ignore_or_to_save_does_not_stop_it(
    capsys: Any, monkeypatch: Any, number: int
) -> None:
    """SIGHUP is ignored beneath nohup; SIGUSR1 asks for a checkpoint, which only training has."""
    monkeypatch.setitem(POLICIES, "noop", interrupted_after(30, number))
    before = signal.signal(number, signal.SIG_DFL if number == signal.SIGUSR1 else signal.SIG_IGN)
    code, out, err = run(capsys, "rollout", "ffa_2", "--worlds=2", "--policy=noop", "--steps=60", "--quiet")
    signal.signal(number, before)
    assert (code, err) == (0, "")
    assert "120 world-steps" in out


def test_requests_to_save_reach_the_inner_of_two_contexts() -> None:
    with save_requests() as outer:
        signal.raise_signal(signal.SIGUSR1)
        with save_requests() as inner:
            signal.raise_signal(signal.SIGUSR1)
        signal.raise_signal(signal.SIGUSR1)
    assert (len(outer), len(inner)) == (2, 1)


def test_children_keep_their_status_where_sigchld_is_ignored() -> None:
    """As in Ray's workers: without that, a process that failed counts as a success, and one that ended as alive."""
    pytest.importorskip("imageio_ffmpeg", reason="needs imageio-ffmpeg: outlast[view]")
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with children_awaited():
            assert subprocess.run(["false"]).returncode == 1
        assert signal.getsignal(signal.SIGCHLD) is signal.SIG_IGN
        with pytest.raises(FilmError, match="FFmpeg failed"):
            _ffmpeg(Path("none.mp4"), "-nothing")
        with ThreadPoolExecutor(1) as pool:  # signals are the main thread's
            assert pool.submit(children_awaited().__enter__).result() is None
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_process_that_is_started_ignores_a_signal_until_it_handles_it() -> None:
    code = "import signal; print(int(signal.getsignal(signal.SIGUSR1)), int(signal.getsignal(signal.SIGTERM)))"
    with ignored("SIGUSR1", "SIGBREAK"):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == [str(int(signal.SIG_IGN)), str(int(signal.SIG_DFL))]
    before = signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    with save_requests() as came:
        signal.raise_signal(signal.SIGUSR1)
    signal.signal(signal.SIGUSR1, before)
    assert len(came) == 1


def test_sigterm_stops_what_ignores_ctrl_c() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    with stops_as_ctrl_c() as came:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert came == [signal.SIGTERM]
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", [*STOPS, signal.SIGUSR1])
def test_a_handler_of_the_caller_stays(number: int) -> None:
    own: list[int] = []
    before = signal.signal(number, lambda number, frame: own.append(number))
    with stops_as_ctrl_c() as came, save_requests() as asked:
        signal.raise_signal(number)
    signal.signal(number, before)
    assert (own, came, asked) == ([number], [], [])


@pytest.mark.parametrize("number", STOPS)
def test_a_fork_ends_at_once(number: int) -> None:
    with stops_as_ctrl_c():
        assert ended(lambda: signal.raise_signal(number)) == -number
    assert ended(lambda: None) == 0


def ended(work: Callable[[], object]) -> int:
    """How a fork ends that does something: minus the signal, or its exit status, 1 if it raised."""
    pid = os.fork()
    if not pid:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
