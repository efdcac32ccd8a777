"""Execution: the units of a segment, bound to the memory of a batch of worlds and to one thread."""

import os
from typing import Any

import numpy as np

from .arguments import ArgumentBlock
from .cache import RUNNER, CompiledUnits
from .errors import EngineError
from .jit import interpreted
from .machine_code import exception_at
from .placing import touched_lines
from .run_units import CHUNK, EXCEPTION, FAILED, FIRST_WORLD, NONE, TABLE, UNITS
from .segments import Segment
from .tick import Unit

CACHED = 1 << 23  # bytes of state that stay in the third-level cache from step to step: to fetch them gains nothing


class CompiledExecution:
    """Runs units that are machine code.

    Args:
        segment: The units.
        worlds: Their tables.
        compiled_units: Loaded.
    """

    def __init__(self, segment: Segment, worlds: Any, compiled_units: CompiledUnits) -> None:
        self._units, self._runner = segment.units, compiled_units.function(RUNNER)
        self.blocks = [ArgumentBlock(unit.arguments, worlds, compiled=True) for unit in segment.units]
        self._frame = np.zeros(TABLE + 2 * len(segment.units), np.int64)
        self._frame[UNITS] = len(segment.units)
        self._frame[TABLE::2] = [compiled_units.address(unit.label) for unit in segment.units]
        self._frame[TABLE + 1 :: 2] = [block.address for block in self.blocks]
        self._frame[FAILED] = NONE
        self._share_fetching(worlds)
        self.address = int(self._frame.ctypes.data)  # of what ecs.run_units takes

    def _share_fetching(self, worlds: Any) -> None:
        """Let the units that run in every tick fetch the worlds that come next, in equal parts, if that pays."""
        fetching = [block for unit, block in zip(self._units, self.blocks, strict=True) if not unit.only_at_reset]
        if worlds.block.nbytes > CACHED and fetching:
            ahead = worlds.block.ctypes.data + CHUNK * worlds.layout.world_bytes
            lines = touched_lines(worlds.layout, worlds.schedule.touched)
            for block, share in zip(fetching, np.array_split(lines, len(fetching)), strict=True):
                block.fetch(ahead, share)

    def __call__(self, start: int, stop: int) -> None:
        """Take the worlds from `start` to `stop` through the units. Raises what a kernel raises."""
        self._runner(self.address, start, stop)
        self.check()

    def check(self) -> None:
        """Raise what a kernel raised since the last call."""
        if self._frame[FAILED] != NONE:
            unit, first_world, exception = (int(self._frame[word]) for word in (FAILED, FIRST_WORLD, EXCEPTION))
            self._frame[FAILED] = NONE
            raise _exception(self._units[unit], first_world, exception)


class PythonExecution:
    """Runs units as Python. Parameters as for CompiledExecution."""

    def __init__(self, segment: Segment, worlds: Any) -> None:
        self._units, self._functions = segment.units, [unit.function() for unit in segment.units]
        self.blocks = [ArgumentBlock(unit.arguments, worlds, compiled=False) for unit in segment.units]

    def __call__(self, start: int, stop: int) -> None:
        """Take the worlds from `start` to `stop` through the units, one after the other."""
        with interpreted():
            for unit, function, block in zip(self._units, self._functions, self.blocks, strict=True):
                try:
                    function(block, start, stop)
                except EngineError as error:
                    raise error if unit.system else type(error)(f"{unit.label}: {error}{unit.needed}") from None


def _exception(unit: Unit, first_world: int, address: int) -> BaseException:
    """The exception that a unit raised, with its name, and a note on how to find the line."""
    kind, arguments, place = exception_at(address)
    file, _, line = place.rpartition(", ")
    place = f" ({os.path.basename(file)}, {line})" if place and unit.system else ""
    text = " ".join(map(str, arguments)) if arguments else kind.__name__
    try:
        error = kind(f"{unit.label}{place}: {text}{unit.needed}")
    except Exception:  # a class that is not made from one text
        error = RuntimeError(f"{unit.label}{place}: {kind.__name__}: {text}")
    note = f"Raised in one of the worlds {first_world} to {first_world + CHUNK - 1}."
    if unit.system:
        note += f' To see the line or to set a breakpoint, run this system as Python, with interpret=("{unit.label}",)'
    error.add_note(note)
    return error
