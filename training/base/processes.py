"""Independent work in several processes of this machine, with results in order. Does not need PyTorch."""

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from outlast.envs.storage.interrupts import children_awaited, ignored

from .errors import TrainingError

GUARD = 'each process imports the program that starts it, which must start it under if __name__ == "__main__":'

T = TypeVar("T")


def spawning() -> Any:
    """Return the context that spawns processes; a fork would share PyTorch's threads. Raises TrainingError."""
    place = str(getattr(sys.modules["__main__"], "__file__", ""))
    if place.startswith("<"):
        where = "standard input" if place == "<stdin>" else place
        raise TrainingError(f"the program comes from {where}, but several processes import it: put it into a file")
    return multiprocessing.get_context("spawn")


def results(jobs: Sequence[Callable[[], T]], at_once: int) -> Iterator[T]:
    """Run jobs, functions that can be pickled, and yield their results in order; with at_once 1, in this process.

    An exception in one of them is raised here and ends all others, as do Ctrl-C and a caller that stops iterating.
    Raises TrainingError if a process was ended from outside, or cannot import the program that starts it.
    """
    count = min(at_once, len(jobs))
    if count <= 1:
        yield from (job() for job in jobs)
        return
    with children_awaited():
        before = set(multiprocessing.active_children())
        context = spawning()
        begun = context.RawValue("b", 0)  # no lock: a killed process could still hold it
        pool = ProcessPoolExecutor(count, context, _begin, (begun,))
        try:
            with ignored("SIGINT", "SIGUSR1"):  # a terminal sends Ctrl-C to all processes, and this one handles it
                pending = [pool.submit(job) for job in jobs]
                pool.submit(int)  # wakes the pool's thread; otherwise it misses the end of the last process started
            for future in pending:
                yield future.result()
        except BaseException as error:
            for process in set(multiprocessing.active_children()) - before:
                process.kill()  # or it finishes its job first; a broken pool misses those that have just started
            if not isinstance(error, BrokenProcessPool):
                raise
            if not begun.value:
                raise TrainingError(f"a process ended before it could play: {GUARD}") from None
            raise TrainingError("a process that played was ended, maybe as memory ran out: take fewer --jobs") from None
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(begun: Any) -> None:
    """Record that a process has begun, and end it, idle or not, when its parent ends for any reason."""
    begun.value = 1

    def watch() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
