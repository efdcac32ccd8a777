"""The runner of a tick: its segments, one after the other, on one thread or several."""

import threading
import time
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

from .cache import CompiledUnits
from .execution import CompiledExecution, PythonExecution
from .jit import compiled
from .segments import Segment
from .tick import Unit
from .workers import Job, Workers

Execution = CompiledExecution | PythonExecution
MIN_RANGE = 16  # worlds a thread takes at a time, at least: enough to pay for the call
RANGES_PER_THREAD = 16  # enough for all threads to end at about the same time


class Runner:
    """Runs a tick in a batch of worlds.

    Attributes:
        units: The machine code.
        times: Seconds spent in each segment, by the label of its first unit.
        lock: Held while executions are made or changed.
    """

    def __init__(
        self, worlds: Any, segments: Sequence[Segment], units: CompiledUnits, functions: Mapping[str, Any]
    ) -> None:
        """Make it; nothing is compiled or loaded yet.

        Args:
            worlds: Their tables, `count` and `threads`.
            segments: The tick.
            units: Its machine code, and that of the functions.
            functions: Kernels of integers by label, see `function`.
        """
        self._worlds = weakref.ref(worlds)  # which refer to this, and are freed when nobody refers to them
        self._count: int = worlds.count
        self._threads: int = worlds.threads
        self._segments, self._functions = segments, functions
        self.units = units
        self.times = {segment.units[0].label: 0.0 for segment in segments}
        self.lock = threading.Lock()
        self._loaded = False
        self._executions: list[list[Execution | None]] = [[None] * self._threads for _ in segments]
        self._workers = Workers(self._threads - 1)

    @property
    def sources(self) -> list[Unit]:
        """All units, in order."""
        return [unit for segment in self._segments for unit in segment.units]

    def run(self) -> None:
        """Take every world through the tick, by its mode."""
        self._load()
        for k, segment in enumerate(self._segments):
            start = time.perf_counter()
            if segment.compiled and self._several:
                self._spread(k)
            else:
                self._call(k, 0, 0, self._count)
            self.times[segment.units[0].label] += time.perf_counter() - start

    def function(self, label: str) -> Any:
        """One of the functions, as machine code that Python can call; as Python where nothing is compiled."""
        self._load()
        return self.units.function(label) if compiled() else self._functions[label]

    def single(self) -> CompiledExecution | None:
        """The execution that is a whole tick; None if that is several calls."""
        self._load()
        execution = None if len(self._segments) > 1 or self._several else self._execution(0, 0)
        return execution if isinstance(execution, CompiledExecution) else None

    def set_numbers(self, changed: Mapping[str, int | float]) -> None:
        """Change numbers of mechanics, by name, from the next tick on. The caller holds `lock`."""
        for execution in (each for segment in self._executions for each in segment if each is not None):
            for block in execution.blocks:
                block.set_numbers(changed)

    def close(self) -> None:
        """End the threads."""
        self._workers.close()

    @property
    def _several(self) -> bool:
        """Whether several threads share the worlds."""
        return self._threads > 1 and self._count > MIN_RANGE

    def _spread(self, segment: int) -> None:
        """Threads, the caller's among them, take the next range of worlds until none is left."""
        count, threads = self._count, self._threads
        size = max(MIN_RANGE, count // (threads * RANGES_PER_THREAD))
        starts = iter(range(0, count, size))  # next() of a range iterator is one step under the GIL

        def work(thread: int) -> None:
            for start in starts:
                self._call(segment, thread, start, min(start + size, count))

        others = [Job(work, thread) for thread in range(1, threads)]
        try:
            self._workers.submit(others)
            work(0)
            for other in others:
                other.result()
        except BaseException:  # an error or Ctrl-C: start no more ranges, and wait for those that run
            for _ in starts:
                pass
            for other in others:
                other.cancel()
            raise

    def _call(self, k: int, thread: int, start: int, stop: int) -> None:
        self._execution(k, thread)(start, stop)

    def _execution(self, k: int, thread: int) -> Execution:
        execution = self._executions[k][thread]
        if execution is None:
            segment = self._segments[k]
            with self.lock:  # of no more than one thread at a time, as modules' scratch() is not made for several
                worlds = self._worlds()
                if segment.compiled:
                    execution = CompiledExecution(segment, worlds, self.units)
                else:
                    execution = PythonExecution(segment, worlds)
                self._executions[k][thread] = execution
        return execution

    def _load(self) -> None:
        if not self._loaded:
            self.units.load()
            self._loaded = True
