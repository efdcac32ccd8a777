"""Execution: the tick of a batch of worlds, segment after segment, on their memory and by several threads."""

import functools
import os
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from ..compilation.arguments import ArgumentBlock, ServiceMemory
from ..compilation.cache import CompiledUnits
from ..compilation.compile_errors import of_numba
from ..compilation.compiled_step import (
    CHUNK,
    ENTRY_WORDS,
    EXCEPTION,
    FAILED,
    FIRST_WORLD,
    MODES,
    NONE,
    RUN,
    TABLE,
    TICK,
    UNITS,
    WHOLE_STEP,
)
from ..compilation.tick import Segment, Unit, in_python
from ..declarations.component import Component
from ..kernels.errors import EngineError
from ..kernels.jit import interpreted
from ..kernels.machine_code import exception_at
from ..memory.tables import Tables, aligned
from .team import SPREAD, TEAM, Team

# Number of worlds that go through all units together: at least TOGETHER; more if their memory takes at most
# TOGETHER_BYTES, which fit into a second-level cache of 0.5 MB.
TOGETHER, TOGETHER_BYTES = 32, 7 << 16
CACHED = 1 << 23  # bytes of state that stay in the third-level cache from step to step: prefetching them has no benefit


class CompiledExecution:
    """Execution of the units of a segment as machine code, on the tables of worlds.

    team: the threads that share the worlds; None: only the caller's thread. touched: see Schedule.touched. `step` runs
    parts of a step, given the address of its block, as compilation.compiled_step.step does.
    """

    def __init__(
        self,
        segment: Segment,
        worlds: Tables,
        compiled_units: CompiledUnits,
        team: Team | None,
        touched: Collection[type[Component]],
    ) -> None:
        self._units, self._code = segment.units, compiled_units
        self._count, self._touched = worlds.count, touched
        self.blocks, self._memories = list[ArgumentBlock](), list[ServiceMemory]()
        self._frames = [self._frame(worlds) for _ in range(1 if team is None else team.size)]
        addresses = [int(frame.ctypes.data) for frame in self._frames]
        step, run = compiled_units.function(WHOLE_STEP), compiled_units.address(RUN)
        self.step: Callable[[int, int], int] = functools.partial(step, addresses[0], run, addresses[0], worlds.count)
        if team is not None:
            self.step = _together_with(team, step, team.plan(run, worlds.count, addresses), addresses[0], worlds.count)

    def _frame(self, worlds: Tables) -> Any:
        """Return the frame of a thread."""
        memory = ServiceMemory(worlds.dims)
        blocks = [ArgumentBlock(unit.arguments, worlds, memory, compiled=True) for unit in self._units]
        self._memories.append(memory)
        frame = aligned(8 * (TABLE + ENTRY_WORDS * len(blocks))).view(np.int64)
        frame[FAILED], frame[UNITS], frame[CHUNK] = NONE, len(blocks), _together(worlds)
        frame[MODES] = worlds.mode.ctypes.data
        entries = [
            [self._code.address(unit.label), block.address, unit.only_at_reset]
            for unit, block in zip(self._units, blocks, strict=True)
        ]
        frame[TABLE:] = np.array(entries, np.int64).ravel()
        self.blocks += blocks
        # The units that run in every tick prefetch the worlds of the next chunk, in equal parts, if that is worthwhile
        fetching = [block for unit, block in zip(self._units, blocks, strict=True) if not unit.only_at_reset]
        if worlds.block.nbytes > CACHED and fetching:
            ahead = worlds.block.ctypes.data + int(frame[CHUNK]) * worlds.layout.world_bytes
            lines = worlds.layout.touched_lines(self._touched)
            for block, share in zip(fetching, np.array_split(lines, len(fetching)), strict=True):
                block.fetch(ahead, share)
        return frame

    def __call__(self) -> None:
        """Run the units on all worlds. Raises exceptions of kernels."""
        if self.step(0, TICK) < 0:
            raise self.error()

    def error(self) -> BaseException:
        """Return the exception of a kernel, after `step` has returned -1, and reset the failure."""
        for memory in self._memories:
            memory.restore()
        frame = self._frames[0]
        unit, first_world, exception = (int(frame[word]) for word in (FAILED, FIRST_WORLD, EXCEPTION))
        last = min(first_world + int(frame[CHUNK]), self._count) - 1
        return _exception(self._units[unit], first_world, last, exception)


def _together_with(team: Team, step: Any, plan: Any, frame: int, count: int) -> Callable[[int, int], int]:
    """Return a function for parts of a step, with a tick that the team shares by this plan."""

    def call(block: int, parts: int) -> int:
        plan[TEAM] = team.ready()
        return int(step(frame, team.code.address(SPREAD), plan.ctypes.data, count, block, parts))

    return call


class PythonExecution:
    """Execution of units as Python, in the caller's thread. The parameters are those of CompiledExecution."""

    def __init__(self, segment: Segment, worlds: Tables) -> None:
        self._memory = ServiceMemory(worlds.dims)
        self._calls = [*in_python(segment.units, worlds, self._memory)]
        self.blocks = [block for _, block, _ in self._calls]

    def __call__(self) -> None:
        """Run the units on all worlds, one after the other."""
        with interpreted():
            for unit, _, call in self._calls:
                try:
                    call()
                except BaseException as error:
                    self._memory.restore()
                    if unit.system or not isinstance(error, EngineError):
                        raise
                    raise type(error)(f"{unit.label}: {error}{unit.needed}") from None


def _together(worlds: Tables) -> int:
    """Return the number of worlds that go through all units together: more need fewer calls, but leave the cache."""
    buffers = (column for c in worlds.components if not c.packed for column in worlds[c])
    used = int(worlds.layout.world_bytes + sum(column.nbytes for column in buffers) // worlds.count)
    return max(TOGETHER, TOGETHER_BYTES // used)


def _exception(unit: Unit, first_world: int, last: int, address: int) -> BaseException:
    """Return the exception at an address, with its unit and line (or the way to find it), and a note on the worlds."""
    kind, arguments, place = exception_at(address)
    file, _, line = place.rpartition(", ")
    shown = place and unit.system and not of_numba(file)  # a line inside numba does not help
    place = f" ({os.path.basename(file)}, {line})" if shown else ""
    text = " ".join(map(str, arguments)).partition('\nFile "')[0] if arguments else kind.__name__  # of numba
    if unit.system and not shown:
        what = ", the array and the index" if issubclass(kind, IndexError) else ""
        text += f'; interpret=("{unit.label}",) runs this system as Python and shows the line{what}'
    try:
        error = kind(f"{unit.label}{place}: {text}{unit.needed}")
    except Exception:  # a class that cannot be created from one text
        error = RuntimeError(f"{unit.label}{place}: {kind.__name__}: {text}")
    worlds = f"one of the worlds {first_world} to {last}" if last > first_world else f"world {last}"
    error.add_note(f"Raised in {worlds} of the batch, counted from 0.")
    return error
