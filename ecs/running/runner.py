"""The runner of a tick: its segments, one after the other, on one thread or several."""

import threading
import time
import weakref
from collections.abc import Mapping
from typing import Any

from ..compilation.compiled_step import WHOLE_STEP, step
from ..compilation.tick import Unit
from ..kernels.jit import compiled
from ..memory.tables import Tables
from .compiled_game import CompiledGame
from .execution import CompiledExecution, PythonExecution
from .team import Team, shared

Execution = CompiledExecution | PythonExecution


class Runner:
    """Runs a tick in a batch of worlds.

    Attributes:
        units: The machine code.
        times: Seconds spent in each segment, by the label of its first unit.
        lock: Held while executions are made or changed.
    """

    def __init__(self, worlds: Tables, threads: int, game: CompiledGame) -> None:
        """Make it; nothing is compiled or loaded yet.

        Args:
            worlds: Their tables.
            threads: How many threads share them.
            game: Its tick, and the machine code of that.
        """
        self._worlds = weakref.ref(worlds)  # weak: they refer to this, and are freed once nobody else refers to them
        self._segments, self._touched = game.segments, game.schedule.touched
        self.units = game.units
        self.times = {segment.units[0].label: 0.0 for segment in self._segments}
        self.lock = threading.Lock()
        self._loaded = False
        self._executions: list[Execution | None] = [None] * len(self._segments)
        self._team = Team(threads) if shared(worlds.count, threads) else None

    @property
    def sources(self) -> list[Unit]:
        """All units, in order."""
        return [unit for segment in self._segments for unit in segment.units]

    @property
    def missing(self) -> list[str]:
        """Labels of the units whose machine code is neither loaded nor on disk."""
        return self.units.missing + (self._team.code.missing if self._team is not None else [])

    def run(self) -> None:
        """Take every world through the tick, by its mode."""
        self._load()
        for k, segment in enumerate(self._segments):
            start = time.perf_counter()
            self._execution(k)()
            self.times[segment.units[0].label] += time.perf_counter() - start

    def step(self) -> Any:
        """compilation.compiled_step.step, for Python to call: as machine code, or as Python if nothing is compiled."""
        self._load()
        return self.units.function(WHOLE_STEP) if compiled() else step

    def single(self) -> CompiledExecution | None:
        """The execution of the whole tick; None if the tick takes several calls."""
        self._load()
        execution = self._execution(0) if len(self._segments) == 1 else None
        return execution if isinstance(execution, CompiledExecution) else None

    def set_numbers(self, changed: Mapping[str, int | float]) -> None:
        """Change numbers of mechanics, by name, from the next tick on. The caller holds `lock`."""
        for execution in (each for each in self._executions if each is not None):
            for block in execution.blocks:
                block.set_numbers(changed)

    def close(self) -> None:
        """End the threads."""
        if self._team is not None:
            self._team.close()

    def _execution(self, k: int) -> Execution:
        execution = self._executions[k]
        if execution is None:
            segment = self._segments[k]
            with self.lock:  # one thread at a time: modules' scratch() need not be thread-safe
                worlds = self._worlds()
                assert worlds is not None  # it is the caller
                if segment.compiled:
                    execution = CompiledExecution(segment, worlds, self.units, self._team, self._touched)
                else:
                    execution = PythonExecution(segment, worlds)
                self._executions[k] = execution
        return execution

    def _load(self) -> None:
        if not self._loaded:
            self.units.load()
            if self._team is not None:
                self._team.code.load()
            self._loaded = True
