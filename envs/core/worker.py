"""A worker thread: Ctrl-C can leave neither it nor its caller waiting for ever.

`concurrent.futures`, `threading.Thread.start` and `threading.Condition` are Python code: if Ctrl-C comes when they have
taken a lock but not yet entered the block that releases it, the lock stays taken, and every thread that needs it waits
for ever. Here each wait is a single C call of a lock or a queue, so Ctrl-C comes before or after it, not within it.
"""

import _thread
import os
import threading
import weakref
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any


class Job:
    """A call for a worker: run once, however often it is submitted."""

    def __init__(self, call: Callable[..., Any], *arguments: Any) -> None:
        self._call = (call, arguments)
        self._result: Any = None
        self._error: BaseException | None = None
        self._claimed, self._unfinished = threading.Lock(), threading.Lock()
        self._unfinished.acquire()

    def run(self) -> None:
        """Make the call, unless it has begun already."""
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
        """Wait for the end; return or raise what the call did."""
        self.wait()
        if self._error is not None:
            raise self._error
        return self._result

    @property
    def finished(self) -> bool:
        """Return whether the call was made and has ended."""
        return not self._unfinished.locked()


class Worker:
    """A thread, started with the first job; it ends with close(), with this object or with the process."""

    def __init__(self) -> None:
        self._owner = 0

    def submit(self, job: Job) -> None:
        """Queue a job. One whose submission was interrupted may be submitted again."""
        if self._owner != os.getpid():  # this is the first job, or a forked process, which inherits no threads
            self._jobs: SimpleQueue[Job | None] = SimpleQueue()
            self._threads: dict[int, threading.Lock] = {}
            self._end = weakref.finalize(self, _end, self._jobs, self._threads, os.getpid())
            self._owner = os.getpid()
        self._jobs.put(job)
        if not self._threads:
            running = threading.Lock()
            running.acquire()
            thread = _thread.start_new_thread(_work, (self._jobs, running))
            self._threads[thread] = running  # Ctrl-C just before this leaves an unlisted thread, which is harmless

    def close(self) -> None:
        """End the thread, after all submitted jobs."""
        if self._owner == os.getpid():
            self._owner = 0
            self._end()


def _work(jobs: "SimpleQueue[Job | None]", running: threading.Lock) -> None:
    while (job := jobs.get()) is not None:
        job.run()
        del job  # so that a waiting thread keeps no job alive
    jobs.put(None)  # ends an unlisted thread, too, see `submit`
    running.release()


def _end(jobs: "SimpleQueue[Job | None]", threads: dict[int, threading.Lock], owner: int) -> None:
    if owner != os.getpid():  # a forked process, which has none of these threads
        return
    jobs.put(None)
    for thread, running in threads.items():
        if thread != threading.get_ident():  # garbage collection may run this in the worker itself
            with running:
                pass
