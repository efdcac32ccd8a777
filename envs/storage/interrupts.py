"""Contexts that make Ctrl-C wait, drop a second Ctrl-C, or treat SIGTERM as Ctrl-C."""

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

A_MOMENT = 1.0  # seconds within which two Ctrl-C count as one: a nervous hand, or a cluster, sends several


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Make Ctrl-C wait until the context ends, so that it runs completely. In other threads nothing changes."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield
        return
    came: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


@contextlib.contextmanager
def one_interrupt(seconds: float = math.inf) -> Iterator[list[float]]:
    """Let only one Ctrl-C interrupt, so that a second one cannot interrupt the cleaning up after the first.

    A second one is usual on clusters, which signal a command and its processes, while the command signals these, too.
    Nothing changes outside of the main thread, where Ctrl-C is ignored, or if the caller's own handler raises nothing.

    Args:
        seconds: How long further ones do nothing after one that has interrupted.

    Yields:
        That number in a list, in which it can be changed meanwhile.
    """
    before, pause = signal.getsignal(signal.SIGINT), [seconds]
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield pause
        return
    came: list[float] = []

    def once(number: int, frame: Any) -> None:
        if came and time.monotonic() - came[-1] < pause[0]:
            return
        try:
            before(number, frame)
        except BaseException:
            came.append(time.monotonic())
            raise

    signal.signal(signal.SIGINT, once)
    try:
        yield pause
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def left_whole() -> Iterator[contextlib.ExitStack]:
    """Let all contexts of a stack be left completely: Ctrl-C that comes meanwhile waits, and a second one is dropped.

    Yields:
        The stack, whose contexts are left at the end.
    """
    with one_interrupt(A_MOMENT) as pause, contextlib.ExitStack() as last, contextlib.ExitStack() as stack:
        try:
            yield stack
        finally:
            pause[0] = math.inf
            last.enter_context(interrupts_held())


@contextlib.contextmanager
def sigterm_as_ctrl_c() -> Iterator[list[int]]:
    """Treat SIGTERM, which schedulers of clusters send before they kill a process, as Ctrl-C.

    Nothing changes outside of the main thread, or if the caller has a handler for SIGTERM.

    Yields:
        The signals that have come so far.
    """
    came: list[int] = []
    free = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if threading.current_thread() is not threading.main_thread() or not free:
        yield came
        return
    owner = os.getpid()

    def pass_on(number: int, frame: object) -> None:
        if os.getpid() != owner:  # in a forked process, SIGTERM ends it as usual: it has nothing to save
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        came.append(number)
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell
            signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGTERM, pass_on)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
