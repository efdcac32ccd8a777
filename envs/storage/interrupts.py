"""Ctrl-C that waits, and SIGTERM that is Ctrl-C."""

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

A_MOMENT = 1.0  # seconds in which two of Ctrl-C are one, as those of a nervous hand, or of a cluster


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Meanwhile Ctrl-C waits, so that what is done here is done whole. Outside of the main thread there is none."""
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
    """Meanwhile Ctrl-C interrupts once, so that a second one cannot come between the first and what cleans up.

    Clusters signal a command and its processes, and the command signals these, too. Outside of the main thread, and
    where Ctrl-C is ignored, nothing changes; nor does it where the caller's own handler raises nothing.

    Args:
        seconds: For how long others do nothing after one that has interrupted.

    Yields:
        That number in a list, to change it meanwhile.
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
    """A stack of contexts that are all left as a whole: Ctrl-C that comes then waits, and a second one is dropped.

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
    """Meanwhile SIGTERM, which schedulers of clusters send before they kill, does what Ctrl-C does.

    Only where it would end the process at once: in the main thread, and where the caller has no handler of its own.

    Yields:
        The signals that came so far.
    """
    came: list[int] = []
    free = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    if threading.current_thread() is not threading.main_thread() or not free:
        yield came
        return
    owner = os.getpid()

    def pass_on(number: int, frame: object) -> None:
        if os.getpid() != owner:  # a fork, which nobody asked to save anything
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        came.append(number)
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background command
            signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.raise_signal(signal.SIGINT)

    signal.signal(signal.SIGTERM, pass_on)
    try:
        yield came
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
