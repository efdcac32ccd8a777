"""Ctrl-C where something has to be done whole, and SIGTERM, which is Ctrl-C to a command."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from outlast.envs.rollout.policies import POLICIES
from outlast.envs.storage.interrupts import interrupts_held, sigterm_as_ctrl_c
from tests.conftest import interrupted_after, run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    """Every test leaves the process as it was."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    now = {number: signal.getsignal(number) for number in before}
    for number, handler in before.items():
        signal.signal(number, handler)
    assert now == before


def test_ctrl_c_waits_for_what_has_to_be_whole() -> None:
    done = []

    def work() -> None:
        with interrupts_held():
            signal.raise_signal(signal.SIGINT)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [1]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_sigterm_waits_as_ctrl_c_does() -> None:
    done = []

    def work() -> None:
        with sigterm_as_ctrl_c(), interrupts_held():
            signal.raise_signal(signal.SIGTERM)
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [1]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
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


def test_sigterm_stops_what_ignores_ctrl_c() -> None:
    """As a shell's background commands do."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    with sigterm_as_ctrl_c() as came:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert came == [signal.SIGTERM]
    signal.signal(signal.SIGINT, before)


def test_a_handler_of_the_caller_stays() -> None:
    own: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: own.append(number))
    with sigterm_as_ctrl_c() as came:
        signal.raise_signal(signal.SIGTERM)
    signal.signal(signal.SIGTERM, before)
    assert (own, came) == ([signal.SIGTERM], [])


def test_a_fork_ends_at_once() -> None:
    with sigterm_as_ctrl_c():
        assert ended(lambda: signal.raise_signal(signal.SIGTERM)) == -signal.SIGTERM
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
