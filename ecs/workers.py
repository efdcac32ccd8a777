"""Worker threads that Ctrl-C cannot leave waiting for each other.

`concurrent.futures`, `threading.Thread.start` and `threading.Condition` are Python code: Ctrl-C after they took a lock
and before they entered the block that releases it leaves the lock taken, and every thread that needs it waits for ever.
Here each wait is a single call into C, of a lock or of a queue, which Ctrl-C either precedes or follows.
"""

import _thread
import os
import threading
import weakref
from collections.abc import Callable, Iterable
from queue import SimpleQueue
from typing import Any


class Job:
    """A call for a worker: run once at most, however often it is submitted."""

    def __init__(self, call: Callable[..., Any], *arguments: Any) -> None:
        self._call = (call, arguments)
        self._result: Any = None
        self._error: BaseException | None = None
        self._claimed, self._unfinished = threading.Lock(), threading.Lock()
        self._unfinished.acquire()

    def run(self) -> None:
        """Make the call, unless somebody else does or did."""
        if not self._claimed.acquire(blocking=False):
            return
        call, arguments = self._call
        try:
            self._result = call(*arguments)
        except BaseException as error:
            self._error = error
        finally:
            del self._call, call, arguments  # what a finished job holds is its result
            self._unfinished.release()

    def cancel(self) -> None:
        """See that it does not run any more: nobody begins it, and where somebody has, wait for the end."""
        if not self._claimed.acquire(blocking=False):
            with self._unfinished:
                pass

    def result(self) -> Any:
        """Wait for the end; return or raise what the call did."""
        with self._unfinished:
            pass
        if self._error is not None:
            raise self._error
        return self._result

    @property
    def finished(self) -> bool:
        """Whether the call was made and has ended."""
        return not self._unfinished.locked()


class Workers:
    """`count` threads, started with the first job and ended by close(), by the collector or with the process."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._owner = 0

    def submit(self, jobs: Iterable[Job]) -> None:
        """Have the jobs run. A job whose submission was interrupted may be submitted again."""
        if self._owner != os.getpid():  # the first ones; or this is a fork, which inherits no threads
            self._jobs: SimpleQueue[Job | None] = SimpleQueue()
            self._threads: dict[int, threading.Lock] = {}
            self._end = weakref.finalize(self, _end, self._jobs, self._threads, os.getpid())
            self._owner = os.getpid()
        for job in jobs:
            self._jobs.put(job)
        while len(self._threads) < self.count:
            running = threading.Lock()
            running.acquire()
            thread = _thread.start_new_thread(_work, (self._jobs, running))
            self._threads[thread] = running  # Ctrl-C ahead of this makes one thread too many, which does no harm

    def close(self) -> None:
        """Let the threads go, after the jobs that were submitted."""
        if self._owner == os.getpid():
            self._owner = 0
            self._end()


def _work(jobs: "SimpleQueue[Job | None]", running: threading.Lock) -> None:
    while (job := jobs.get()) is not None:
        job.run()
        del job  # while it waits for the next one, a thread keeps nothing alive
    jobs.put(None)  # for the next thread
    running.release()


def _end(jobs: "SimpleQueue[Job | None]", threads: dict[int, threading.Lock], owner: int) -> None:
    if owner != os.getpid():  # a fork, which has none of them
        return
    jobs.put(None)
    for thread, running in threads.items():
        if thread != threading.get_ident():  # in which the collector may have found the last reference
            with running:
                pass
