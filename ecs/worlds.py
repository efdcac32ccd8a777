"""A batch of worlds of one scenario, their tables, and the runner that takes blocks of them through the tick."""

import contextlib
import os
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numba.core.errors import TypingError

from . import schedule
from .cache import is_cached
from .component import Clock, Component
from .errors import DeclarationError, ScheduleError
from .layout import Layout
from .module import Module
from .phase import Phase
from .tick import Segment, segments
from .view import WIDTH, describe

LEAST = 16  # worlds a thread takes at a time, at least: enough to pay for the call
SHARES = 16  # blocks for each thread: enough for all of them to end together


class Worlds:
    """`count` worlds made of `modules`, stored as tables and advanced together.

    worlds[C] is the table of component C: columns of shape (count, capacity, ...) or, per world, (count, ...).
    The arrays are the state itself and stay the same objects for life. split: compile every system by itself and take
    all worlds through one after the other, to time them (see `times`); the results are the same. without: phases to
    leave out, for whoever wants no observations, say.
    Raises DeclarationError or ScheduleError when the modules do not fit together.
    """

    def __init__(
        self,
        modules: Sequence[Module],
        count: int,
        threads: int = 1,
        split: bool = False,
        without: Collection[Phase] = (),
    ) -> None:
        self.layout = Layout(modules)
        self.count, self.threads = count, threads
        systems = [system for module in self.layout.modules for system in module.systems()]
        systems = [system for system in systems if self._applies(system) and system.phase not in without]
        self.schedule = schedule.order(systems, self.layout.components)
        self.block = np.zeros((count, self.layout.world_bytes), np.uint8)
        self.block[:] = self.layout.template
        self._tables = {c: self._allocate(c) for c in self.layout.components}
        self._segments = segments(self.layout, self.schedule.systems, split)
        self.times = [0.0] * len(self._segments)  # seconds spent in each; with split, in each system of the schedule
        self._inputs = [_Inputs(segment, self.dims) for segment in self._segments]
        self._columns = self._column_rows()
        self._pool: ThreadPoolExecutor | None = None
        self._owner = os.getpid()

    def __getitem__(self, component: type[Component]) -> Any:
        try:
            return self._tables[component]
        except KeyError:
            known = ", ".join(sorted(c.__name__ for c in self._tables))
            raise DeclarationError(f"this scenario has no component {component.__name__}; it has: {known}") from None

    def __contains__(self, component: type[Component]) -> bool:
        return component in self._tables

    @property
    def components(self) -> tuple[type[Component], ...]:
        """All components, in the order of storage."""
        return self.layout.components

    @property
    def dims(self) -> dict[str, int]:
        """Named dimensions of this scenario: "rows", and what its modules define."""
        return self.layout.dims

    @property
    def compiled(self) -> bool:
        """Whether machine code for this tick is ready or lies on disk."""
        return all(is_cached(segment.function) for segment in self._segments)

    def span(self, archetype: str) -> slice:
        """Rows of an archetype, the same in every world; an empty slice if this scenario lacks it."""
        rows = self.layout.spans.get(archetype, range(0))
        return slice(rows.start, rows.stop)

    def seed(self, seeds: Any, worlds: Any, where: Any = slice(None)) -> None:
        """Key the random numbers of the worlds `where` by (seeds, worlds); their episodes count from the start."""
        clock = self[Clock]
        clock.seed[where] = np.asarray(seeds, np.uint64).reshape(-1, 1)
        clock.world[where] = np.asarray(worlds, np.uint64).reshape(-1, 1)
        clock.episode[where] = 0

    def run(self, mode: np.ndarray[Any, Any]) -> None:
        """Take every world through the tick: mode int8 (count,), SKIP, STEP or RESET for each world."""
        for k, (segment, inputs) in enumerate(zip(self._segments, self._inputs, strict=True)):
            start = time.perf_counter()
            if self.threads == 1 or not segment.compiled or self.count <= LEAST:
                self._call(segment, inputs, 0, 0, self.count, mode)
            else:
                self._spread(segment, inputs, mode)
            self.times[k] += time.perf_counter() - start

    def close(self) -> None:
        """Let the threads go. The tables stay readable."""
        if self._pool is not None and self._owner == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def _spread(self, segment: Segment, inputs: "_Inputs", mode: np.ndarray[Any, Any]) -> None:
        """Threads take the next block of worlds until none is left; the caller's thread is one of them."""
        block = max(LEAST, self.count // (self.threads * SHARES))
        starts = iter(range(0, self.count, block))  # next() of a range iterator is one step under the GIL

        def work(thread: int) -> None:
            for start in starts:
                self._call(segment, inputs, thread, start, min(start + block, self.count), mode)

        if self._pool is None or self._owner != os.getpid():  # after a fork, threads do not exist any more
            self._pool, self._owner = ThreadPoolExecutor(self.threads - 1, "outlast"), os.getpid()
        others = [self._pool.submit(work, thread) for thread in range(1, self.threads)]
        try:
            work(0)
        finally:
            for _ in starts:  # after an error or Ctrl-C: no new blocks
                pass
            wait(others)
        for other in others:
            other.result()

    def _call(self, segment: Segment, inputs: "_Inputs", thread: int, start: int, stop: int, mode: Any) -> None:
        scratch = inputs.scratch(thread)
        arguments = (mode, self._columns, inputs.constants, scratch, inputs.integers, inputs.reals)
        if segment.compiled:
            with _plain_errors():
                segment.function(start, stop, *arguments)
        else:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                segment.function(start, stop, *arguments)

    def _applies(self, system: Any) -> bool:
        """A system one of whose row sets is empty has nothing to do: it is dormant and not scheduled."""
        return all(len(self.layout.rows(*p.components)) > 0 for p in system.parameters if p.kind == "rows")

    def _allocate(self, component: type[Component]) -> Any:
        if component.packed:
            return self.layout.columns(self.block, component)
        columns = component.columns.items()
        return component.Table(
            *(np.zeros((self.count, *component.row_shape(name, self.dims)), column.dtype) for name, column in columns)
        )

    def _column_rows(self) -> np.ndarray[Any, Any]:
        """Where every column lies, and last the blocks of the worlds themselves."""
        columns = [(getattr(self[place.component], place.name), place.shape) for place in self.layout.places]
        columns.append((self.block, (self.layout.world_bytes // 8,)))
        return np.array([describe(column, column.strides[0], shape) for column, shape in columns], np.int64)


class _Inputs:
    """The arguments of one segment as arrays; scratch memory is made once for each thread."""

    def __init__(self, segment: Segment, dims: dict[str, int]) -> None:
        arguments = segment.arguments
        self.segment, self.dims = segment, dims
        self.kept = arguments.constants
        self.constants = _rows(self.kept)
        self.integers = np.array([*arguments.integers, 0], np.int64)
        self.reals = np.array([*arguments.reals, 0.0], np.float32)
        self._scratch: dict[int, tuple[list[Any], Any]] = {}
        self._lock = threading.Lock()

    def scratch(self, thread: int) -> Any:
        """Where the thread's scratch memory lies; for a Python segment, the memory itself."""
        with self._lock:
            if thread not in self._scratch:
                memory = [module.scratch(name, self.dims) for module, name in self.segment.arguments.scratch]
                self._scratch[thread] = (memory, _rows(memory) if self.segment.compiled else memory)
        return self._scratch[thread][1]


def _rows(arrays: Sequence[np.ndarray[Any, Any]]) -> np.ndarray[Any, Any]:
    return np.array([describe(array, 0, array.shape) for array in arrays], np.int64).reshape(len(arrays), WIDTH)


@contextlib.contextmanager
def _plain_errors() -> Iterator[None]:
    """A kernel that does not compile, told in the words of the engine."""
    try:
        yield
    except TypingError as error:
        if "readonly array" in str(error):
            raise ScheduleError(
                "a system writes a component that its parameter list declares as Read; declare it Write (or Add)\n"
                + str(error)
            ) from None
        raise
