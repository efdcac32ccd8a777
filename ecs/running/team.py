"""A team of threads that run a tick of worlds together, without the GIL.

Python starts the threads, each by one call of machine code (`serve`) that lasts until the team is dismissed. In a round
(`spread`), the caller and the threads take ranges of worlds, first from their own shares and then from the others',
until all are taken. The caller does not wait for threads that have not woken up by then: they find the round closed.

The words of a team are read and written by sequentially consistent atomic operations. These also order all other
memory: threads see what the caller wrote before it opened the round, and the caller sees what threads wrote before they
stopped being active. The mutex and the conditions are for sleeping only.
"""

import _thread
import functools
import os
import threading
import warnings
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..compilation.cache import CompiledUnits
from ..compilation.compiled_step import EXCEPTION, FAILED, FIRST_WORLD, NONE, STEP_BLOCK
from ..kernels.jit import external, has_symbol, kernel, loader, storer
from ..kernels.machine_code import atomic_add, atomic_load, atomic_store, call_address
from ..memory.tables import aligned

LINE = 8  # words of a cache line: different threads write to different lines
ROUND, OPEN, ACTIVE, ASLEEP, WAITING = range(0, 5 * LINE, LINE)  # words of a team, see `serve` and `spread`
DISMISSED, HIRED, PLAN = ROUND + 1, ROUND + 2, OPEN + 1
MUTEX, BEGUN, ENDED = range(5 * LINE, 11 * LINE, 2 * LINE)  # pthreads' objects: they need at most 64 bytes
NEXT = 11 * LINE  # from here, a line for each thread, with the next world of its share
TEAM, FUNCTION, COUNT, SHARE, RANGE, THREADS, FRAMES = range(7)  # words of a plan, see `spread`
GLANCES = 100  # number of checks of a waiting thread before it sleeps: about 50 microseconds
MIN_RANGE = 16  # minimum worlds that a thread takes at a time: enough to justify the call
RANGES_PER_THREAD = 8  # enough for all threads to end at about the same time

SPREAD = "spread"  # label
NO_PYTHON = "several threads run machine code only"
initialize_mutex = external("pthread_mutex_init", "int32", "intp", "intp", cure=NO_PYTHON)
initialize_condition = external("pthread_cond_init", "int32", "intp", "intp", cure=NO_PYTHON)
lock = external("pthread_mutex_lock", "int32", "intp", cure=NO_PYTHON)
unlock = external("pthread_mutex_unlock", "int32", "intp", cure=NO_PYTHON)
wait = external("pthread_cond_wait", "int32", "intp", "intp", cure=NO_PYTHON)
wake_all = external("pthread_cond_broadcast", "int32", "intp", cure=NO_PYTHON)
pause = external("sched_yield", "int32", cure=NO_PYTHON)
read_word, write_word = loader("int64"), storer("int64")


@kernel
def prepare(team: int) -> int:
    """Initialise the mutex and the conditions of a team, whose words are 0."""
    initialize_mutex(team + 8 * MUTEX, 0)
    initialize_condition(team + 8 * BEGUN, 0)
    initialize_condition(team + 8 * ENDED, 0)
    return 0


@kernel
def serve(team: int, others: int) -> int:
    """Work in the team until it is dismissed. Threads beyond the number `others` return at once."""
    thread = atomic_add(team + 8 * HIRED, 1) + 1
    if thread > others:
        return 0
    seen = 0
    while True:
        for _ in range(GLANCES):
            if atomic_load(team + 8 * ROUND) != seen:
                break
            pause()
        if atomic_load(team + 8 * ROUND) == seen:
            lock(team + 8 * MUTEX)
            atomic_add(team + 8 * ASLEEP, 1)  # before it reads ROUND: see `announce`
            while atomic_load(team + 8 * ROUND) == seen:
                wait(team + 8 * BEGUN, team + 8 * MUTEX)
            atomic_add(team + 8 * ASLEEP, -1)
            unlock(team + 8 * MUTEX)
        seen = atomic_load(team + 8 * ROUND)
        if atomic_load(team + 8 * DISMISSED):
            return 0
        atomic_add(team + 8 * ACTIVE, 1)  # before it reads OPEN: an open round waits for it
        if atomic_load(team + 8 * OPEN):
            take_ranges(read_word(team + 8 * PLAN), thread)
        if atomic_add(team + 8 * ACTIVE, -1) == 1 and atomic_load(team + 8 * WAITING):
            lock(team + 8 * MUTEX)
            wake_all(team + 8 * ENDED)
            unlock(team + 8 * MUTEX)


@kernel
def announce(team: int) -> int:
    """Notify the threads of a new round."""
    atomic_add(team + 8 * ROUND, 1)
    if atomic_load(team + 8 * ASLEEP):
        lock(team + 8 * MUTEX)  # threads that saw the old ROUND are asleep by now
        wake_all(team + 8 * BEGUN)
        unlock(team + 8 * MUTEX)
    return 0


@kernel
def take_ranges(plan: int, thread: int) -> None:
    """Take ranges of worlds, first of the thread's own share, through the tick until all are taken or a unit fails.

    The shares are the same in each round, so that a processor finds its worlds in its cache.
    """
    function, frame = read_word(plan + 8 * FUNCTION), read_word(plan + 8 * (FRAMES + thread))
    threads, size = read_word(plan + 8 * THREADS), read_word(plan + 8 * RANGE)
    for k in range(thread, thread + threads):
        following, stop = next_and_stop(plan, k % threads)
        while True:
            first = atomic_add(following, size)
            if first >= stop:
                break
            call_address(function, frame, first, min(first + size, stop), frame + 8 * EXCEPTION)
            if read_word(frame + 8 * FAILED) != NONE:
                for other in range(threads):
                    following, stop = next_and_stop(plan, other)
                    atomic_store(following, stop)
                return


@kernel
def next_and_stop(plan: int, thread: int) -> tuple[int, int]:
    """Return the address of the word with the next world of a thread's share, and one after its last world."""
    following = read_word(plan + 8 * TEAM) + 8 * (NEXT + LINE * thread)
    return following, min((thread + 1) * read_word(plan + 8 * SHARE), read_word(plan + 8 * COUNT))


@kernel
def spread(plan: int, first: int, last: int) -> int:
    """Run a round: the team runs the tick of all worlds from `first` to `last`.

    A plan has int64 words, see the names above: the team; the function of the tick, run_units; the numbers of all
    worlds, of worlds in a share and of worlds in a range; the number of threads, and the frame of each. Afterwards,
    the caller's frame has the failed unit, if one failed in any thread.
    """
    team, threads, own = read_word(plan + 8 * TEAM), read_word(plan + 8 * THREADS), read_word(plan + 8 * FRAMES)
    begin = first
    for k in range(threads):
        frame = read_word(plan + 8 * (FRAMES + k))
        write_word(frame + 8 * FAILED, NONE)
        write_word(frame + 8 * STEP_BLOCK, read_word(own + 8 * STEP_BLOCK))
        following, stop = next_and_stop(plan, k)
        atomic_store(following, begin)
        begin = stop
    write_word(team + 8 * PLAN, plan)
    atomic_store(team + 8 * OPEN, 1)
    announce(team)
    take_ranges(plan, 0)
    atomic_store(team + 8 * OPEN, 0)
    for _ in range(GLANCES):
        if atomic_load(team + 8 * ACTIVE) == 0:
            break
        pause()
    if atomic_load(team + 8 * ACTIVE):
        atomic_store(team + 8 * WAITING, 1)
        lock(team + 8 * MUTEX)
        while atomic_load(team + 8 * ACTIVE):
            wait(team + 8 * ENDED, team + 8 * MUTEX)
        unlock(team + 8 * MUTEX)
        atomic_store(team + 8 * WAITING, 0)
    for k in range(1, threads):
        frame = read_word(plan + 8 * (FRAMES + k))
        if read_word(frame + 8 * FAILED) != NONE:
            earlier = read_word(frame + 8 * FIRST_WORLD) < read_word(own + 8 * FIRST_WORLD)
            if read_word(own + 8 * FAILED) == NONE or earlier:
                for word in (FAILED, FIRST_WORLD, EXCEPTION):
                    write_word(own + 8 * word, read_word(frame + 8 * word))
    return 0


@kernel
def dismiss(team: int) -> int:
    """Make the threads return."""
    atomic_store(team + 8 * DISMISSED, 1)
    announce(team)
    return 0


@functools.cache
def code() -> CompiledUnits:
    """Return the machine code of teams."""
    return CompiledUnits((), {"prepare": prepare, "serve": serve, "dismiss": dismiss}, {SPREAD: spread})


def shared(count: int, threads: int) -> bool:
    """Return whether this many threads share this many worlds. Warns if the system has no POSIX threads."""
    possible = has_symbol("pthread_cond_wait") and has_symbol("sched_yield")
    if threads > 1 and not possible:
        warnings.warn(f"threads={threads} has no effect: this system has no POSIX threads", stacklevel=2)
    return threads > 1 and count > MIN_RANGE and possible


class Team:
    """The caller's thread and others, started when they are needed, and again in a fork, once `code` is loaded."""

    def __init__(self, size: int) -> None:
        self.size, self.code = size, code()
        self._owner = 0

    def plan(self, function: int, count: int, frames: Sequence[int]) -> Any:
        """Return the plan for `spread`, with 0 instead of the team's address, which `ready` returns."""
        share = max(MIN_RANGE, -(-count // self.size))
        size = max(MIN_RANGE, -(-share // RANGES_PER_THREAD))
        return np.array([0, function, count, share, size, self.size, *frames], np.int64)

    def ready(self) -> int:
        """Start the threads that are not running yet, and return the team's address."""
        if self._owner != os.getpid():  # no threads yet, or this is a fork, which inherits none
            self._words = aligned(8 * (NEXT + LINE * self.size)).view(np.int64)
            self._threads = list[tuple[int, threading.Lock]]()
            self._address = int(self._words.ctypes.data)
            self.code.function("prepare")(self._address)
            dismissing = self.code.function("dismiss"), self._words, self._threads, os.getpid()
            self._end = weakref.finalize(self, _end, *dismissing)
            self._owner = os.getpid()
        while len(self._threads) < self.size - 1:
            running = threading.Lock()
            running.acquire()
            serving = self.code.function("serve"), self._words, self.size - 1, running
            thread = _thread.start_new_thread(_serve, serving)
            self._threads.append((thread, running))  # after Ctrl-C just before this, one too many starts: it returns
        return self._address

    def close(self) -> None:
        """End the threads."""
        if self._owner == os.getpid():
            self._owner = 0
            self._end()


def _serve(serve: Any, words: Any, others: int, running: threading.Lock) -> None:
    try:
        serve(words.ctypes.data, others)
    finally:
        running.release()


def _end(dismiss: Any, words: Any, threads: list[tuple[int, threading.Lock]], owner: int) -> None:
    if owner != os.getpid():  # a fork does not have these threads
        return
    dismiss(words.ctypes.data)
    for thread, running in threads:
        if thread != threading.get_ident():  # garbage collection may run this in one of them
            with running:
                pass
