"""Calls of one environment: one at a time, including a call in the background whose result is fetched later.

Ctrl-C can leave neither the call nor its caller waiting for ever. `concurrent.futures` and `threading.Thread.start` are
Python code: if Ctrl-C comes when they have taken a lock but not yet entered the block that releases it, every thread
that needs it waits for ever. Here each wait is a single C call of a lock, so Ctrl-C comes before or after it.
"""

import _thread
import functools
import os
import threading
from collections.abc import Callable
from threading import get_ident
from typing import Any, Concatenate, ParamSpec, TypeVar

from ..errors import ClosedError, PendingError

Options = ParamSpec("Options")
Result = TypeVar("Result")


class Job:
    """A call in its own thread, made once even if it is started repeatedly."""

    def __init__(self, call: Callable[..., Any], *arguments: Any) -> None:
        self._call = (call, arguments)
        self._result: Any = None
        self._error: BaseException | None = None
        self._claimed, self._unfinished = threading.Lock(), threading.Lock()
        self._unfinished.acquire()

    def start(self) -> None:
        """Make the call, unless it has begun or ended. A start that Ctrl-C interrupted may be repeated."""
        if not self.finished:
            _thread.start_new_thread(self._run, ())

    def _run(self) -> None:
        if not self._claimed.acquire(blocking=False):
            return
        call, arguments = self._call
        try:
            self._result = call(*arguments)
        except BaseException as error:
            self._error = error
        finally:
            del self._call, call, arguments  # a finished job keeps only its result alive
            self._unfinished.release()

    def wait(self) -> None:
        """Wait for the end."""
        with self._unfinished:
            pass

    def result(self) -> Any:
        """Wait for the end; return its result, or raise its exception."""
        self.wait()
        if self._error is not None:
            raise self._error
        return self._result

    @property
    def finished(self) -> bool:
        """Return whether the call was made and has ended."""
        return not self._unfinished.locked()


class CallGuard:
    """A re-entrancy guard, and one call in the background.

    `exclusive` makes methods that raise PendingError while another thread is inside.
    """

    def __init__(self) -> None:
        self.pending: Job | None = None  # a call that has begun and whose result has not been fetched
        self._owner = os.getpid()
        # the thread that is in a call; if Ctrl-C leaves it here, the thread's next call clears it
        self.inside: dict[str, int] = {}

    def enter(self) -> None:
        """Begin a call, which ends by `inside.pop("thread")`. Raises PendingError if another thread is in a call."""
        me = get_ident()
        if self.inside.setdefault("thread", me) != me:
            raise PendingError("another thread is in a call of this environment; make an environment for each thread")

    def begin(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Begin a call. The previous one must have been fetched. Raises PendingError if another thread is in a call."""
        self.enter()
        self.inside.pop("thread", None)
        self._owner = os.getpid()
        self.pending = Job(self._guarded, call, *arguments)
        self.pending.start()

    def fetch(self) -> Any:
        """Wait for the call, and return its result or raise its exception. Raises PendingError if no call has begun."""
        if (job := self.pending) is None:
            raise PendingError("recv() without send()")
        self.check_owner()
        job.start()  # again, as Ctrl-C may have interrupted `begin` before it did so
        try:
            result = job.result()
        finally:
            mine = self.pending is job
            if mine and job.finished:  # after Ctrl-C it may be unfinished; it can be fetched later
                self.pending = None
        if not mine:
            raise PendingError("another thread has received this step; recv() is for one thread")
        return result

    def check_owner(self) -> None:
        """Raise PendingError for a call that began before this process was forked."""
        if self.pending is not None and self._owner != os.getpid():
            raise PendingError("the step was sent by another process, of which this is a fork; make a new environment")

    def wait(self) -> None:
        """Wait for the end of a call that has begun, if any; its result can still be fetched."""
        job, here = self.pending, self._owner == os.getpid() and self.inside.get("thread") != get_ident()
        if job is not None and here:
            job.start()  # again, as in `fetch`
            job.wait()

    def _guarded(self, call: Callable[..., Any], *arguments: Any) -> Any:
        self.enter()
        try:
            return call(*arguments)
        finally:
            self.inside.pop("thread", None)


def exclusive(call: Callable[Concatenate[Any, Options], Result]) -> Callable[Concatenate[Any, Options], Result]:
    """Let only one thread at a time enter a method, and only of an open environment. ClosedError, PendingError."""

    @functools.wraps(call)
    def checked(env: Any, /, *arguments: Options.args, **options: Options.kwargs) -> Result:
        guard: CallGuard = env._guard
        if env.closed or guard.pending is not None:  # without taking the guard, which a call in the background needs
            check_callable(env)
        me, inside = get_ident(), guard.inside
        # as in `enter`; calling that would add a tenth to a step of one world
        if inside.setdefault("thread", me) != me:
            guard.enter()
        try:
            return call(env, *arguments, **options)
        finally:
            inside.pop("thread", None)

    return checked


def check_callable(env: Any) -> None:
    """Refuse calls after close() (ClosedError) and between send() and recv() (PendingError)."""
    if env.closed:
        raise ClosedError("the environment is closed; make a new one")
    env._guard.check_owner()
    if env._guard.pending is not None:
        raise PendingError("a step was sent and not received; call recv() first")
