"""Contexts that make Ctrl-C wait, drop a second Ctrl-C, treat other signals as Ctrl-C, collect, ignore or heed them."""

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any

A_MOMENT = 1.0  # a second Ctrl-C within these seconds is ignored: clusters and users send several


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Make Ctrl-C wait until the context ends, so that it runs completely. In other threads nothing changes."""
    came = _Collected()
    try:
        with _handled([signal.SIGINT], came):
            yield
    finally:
        if came:
            signal.raise_signal(signal.SIGINT)


@contextlib.contextmanager
def one_interrupt(seconds: float = math.inf) -> Iterator[list[float]]:
    """Allow only one Ctrl-C, so that a second one cannot interrupt the clean-up after the first.

    A second one is usual on clusters, which signal a command and its processes, while the command signals these, too.
    Nothing changes outside of the main thread, where Ctrl-C is ignored, or if the caller's own handler raises nothing.
    Yields the seconds after an interrupt in which further ones are ignored, in a list, in which they can be changed.
    """
    before: Any = signal.getsignal(signal.SIGINT)
    pause, came = [seconds], list[float]()

    def once(number: int, frame: Any) -> None:
        if came and time.monotonic() - came[-1] < pause[0]:
            return
        try:
            before(number, frame)
        except BaseException:
            came.append(time.monotonic())
            raise

    with _handled([signal.SIGINT] if callable(before) else [], once):
        yield pause


@contextlib.contextmanager
def left_whole() -> Iterator[contextlib.ExitStack]:
    """Yield a stack, whose contexts are left completely: a Ctrl-C during that waits, and a second one is dropped."""
    with one_interrupt(A_MOMENT) as pause, contextlib.ExitStack() as last, contextlib.ExitStack() as stack:
        try:
            yield stack
        finally:
            pause[0] = math.inf
            last.enter_context(interrupts_held())


@contextlib.contextmanager
def stops_as_ctrl_c() -> Iterator[list[int]]:
    """Treat SIGTERM and SIGHUP as Ctrl-C: schedulers of clusters, and closed terminals, send them to stop a process.

    Nothing changes outside of the main thread, or for a signal that the caller handles or ignores, as nohup does.
    Yields the signals received so far.
    """
    came: list[int] = []
    free = [number for number in _numbers("SIGTERM", "SIGHUP") if signal.getsignal(number) is signal.SIG_DFL]
    owner = os.getpid()

    def pass_on(number: int, frame: object) -> None:
        if os.getpid() != owner:  # in a forked process, the signal ends it as usual: it has nothing to save
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        came.append(number)
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell
            signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.raise_signal(signal.SIGINT)

    with _handled(free, pass_on):
        yield came


@contextlib.contextmanager
def save_requests() -> Iterator[list[int]]:
    """Collect SIGUSR1, which requests a checkpoint and otherwise ends the process.

    Nothing changes outside of the main thread, if the caller has a handler of its own, or without SIGUSR1. Yields the
    signals received so far, except in a context inside this one.
    """
    free = [each for each in _numbers("SIGUSR1") if isinstance(signal.getsignal(each), signal.Handlers | _Collected)]
    with _handled(free, came := _Collected()):
        yield came


@contextlib.contextmanager
def ignored(*names: str) -> Iterator[None]:
    """Ignore signals in this process and in those that it starts; not in other threads."""
    with _handled(_numbers(*names), signal.SIG_IGN):
        yield


@contextlib.contextmanager
def children_awaited() -> Iterator[None]:
    """Keep the statuses of processes that end until they are waited for, even if SIGCHLD is ignored; in this thread.

    Ray's workers and children of some daemons ignore it. Then Python takes a process that failed for a success, or
    goes on waiting for one that has ended.
    """
    with _handled((each for each in _numbers("SIGCHLD") if signal.getsignal(each) is signal.SIG_IGN), signal.SIG_DFL):
        yield


class _Collected(list[int]):
    """Signals, collected by this list itself as their handler."""

    def __call__(self, number: int, frame: object) -> None:
        self.append(number)


def _numbers(*names: str) -> list[signal.Signals]:
    """Return the signals of these names that this system has."""
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


@contextlib.contextmanager
def _handled(numbers: Iterable[signal.Signals], handler: Any) -> Iterator[None]:
    """Handle signals in this context, if it is in the main thread and they were not handled in another language."""
    main = threading.current_thread() is threading.main_thread()
    before = {number: old for number in numbers if main and (old := signal.getsignal(number)) is not None}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
