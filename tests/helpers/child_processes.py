"""Processes that tests start: their children, whether they still run, and waiting for them."""

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

PATIENCE = 200  # seconds


def children(pid: int) -> list[int]:
    """The processes that were started by this one."""
    return [int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def lives(pid: int) -> bool:
    """Return whether a process runs: neither ended nor a zombie."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def until(condition: Callable[[], bool]) -> None:
    """Wait until the condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
