"""Steps and resets of episodes: actions in, ends of episodes out."""

import functools
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ..compilation.compiled_step import (
    BEGIN,
    CUT_SHORT,
    DONE,
    FAULT,
    FINISH,
    HAS_ENDED,
    NOT_RUNNING,
    OUT_OF_RANGE,
    TICK,
    WHOLE_STEP,
    WORDS,
    step,
)
from ..kernels.jit import compiled
from ..memory.episode import RESET, SKIP
from .execution import CompiledExecution
from .worlds import Worlds

Array = np.ndarray[Any, Any]


class Observer(Protocol):
    """An observer of each tick of a Stepper, such as a recorder. `mode`: the mode of each world, int8."""

    @property
    def recording(self) -> bool:
        """Return whether it continues to observe."""

    def check(self, mode: Array) -> None:
        """Raise an exception to refuse the tick, before anything has changed."""

    def before(self, mode: Array) -> None:
        """Observe the state before the tick."""

    def after(self, mode: Array) -> None:
        """Observe the state after the tick. An exception does not undo the tick."""

    def close(self) -> None:
        """End the observation."""


class Stepper:
    """The steps and resets of a batch of worlds.

    A step has three parts: the first checks it, and takes the actions into the tables; the tick; and the last
    determines which episodes are over. If machine code does all three and there are no observers, they are one call;
    otherwise systems in Python, and observers, run in between.

    Attributes:
        actions: Actions of the next step, int64 (worlds, rows, actions); each from 0 to its size - 1.
        mode: The mode of each world in the last tick: SKIP, STEP or RESET, int8 (worlds,).
        running: Whether a world has started and was not interrupted in mid-tick: bool (worlds,).
        ended: Whether one of the columns `ends` has ended it: bool (worlds,).
        stopped: Whether the caller has stopped it; set by the caller: bool (worlds,). A tick of the world resets it.
        faulty: Whether one of the columns `faults` reports a fault: bool (worlds,).
        observers: The observers.
    """

    # flags that `step` returns: the reason of a refusal, or the result of a step
    NOT_RUNNING, HAS_ENDED, OUT_OF_RANGE, DONE, FAULT = NOT_RUNNING, HAS_ENDED, OUT_OF_RANGE, DONE, FAULT
    REFUSED = NOT_RUNNING | HAS_ENDED | OUT_OF_RANGE

    def __init__(
        self,
        worlds: Worlds,
        actions: Array,
        ends: Sequence[Array],
        faults: Sequence[Array] = (),
        *,
        resets: bool = True,
        at_once: bool = False,
    ) -> None:
        """Create it; none of the worlds is running yet.

        Args:
            worlds: The worlds.
            actions: Memory for `actions`.
            ends: Columns, (worlds, ...), that end a world's episode if any of their entries is not 0.
            faults: Columns that report a fault in the same way.
            resets: Whether a step resets worlds that ended in the previous one; otherwise it is refused.
            at_once: Whether the caller resets them right after that step.
        """
        self.worlds, self.mode, self.actions = worlds, worlds.mode, actions
        self.running, self.ended, self.stopped, self.faulty = (np.zeros(worlds.count, bool) for _ in range(4))
        self.observers = list[Observer]()
        self._buffers = [  # which systems write only at changes
            column for component in worlds.components if not component.packed for column in worlds[component]
        ]
        self._where, self._all = np.ones(worlds.count, bool), True
        columns = [component.columns[name] for component, name in worlds.layout.actions]
        self._zeros = np.array([-int(column.low) for column in columns], np.int64)
        flags = {"running": self.running, "ended": self.ended, "stopped": self.stopped, "faulty": self.faulty}
        self._arrays = {  # kept alive: the words below are their addresses
            "actions": actions,
            "sizes": np.array([int(column.high - column.low) + 1 for column in columns], np.int64),
            "zeros": self._zeros,
            "taken": worlds.actions,
            "where": self._where,
            "mode": self.mode,
            "ends": np.array([_place(column) for column in ends], np.int64),
            "faults": np.array([_place(column) for column in faults], np.int64),
            **flags,
        }
        words = {name: array.ctypes.data for name, array in self._arrays.items()}
        words |= {"worlds": worlds.count, "rows": actions.shape[1], "columns": actions.shape[2]}
        words |= {"taken_bytes": worlds.actions.itemsize, "ranges": True, "resets": resets, "at_once": at_once}
        words |= {"end_columns": len(ends), "fault_columns": len(faults)}
        self._block = np.array([words[name] for name in WORDS], np.int64)
        self._address, self._ranges = int(self._block.ctypes.data), True

    def load(self) -> None:
        """Load or compile all code of a step."""
        first, *others = self.worlds.load()
        part = self.worlds.units.function(WHOLE_STEP) if compiled() else step
        self._part = functools.partial(part, 0, 0, 0, self.worlds.count, self._address)
        self._tick = tick = first if isinstance(first, CompiledExecution) and not others else None
        self._whole = None if tick is None else functools.partial(tick.step, self._address, BEGIN | TICK | FINISH)

    @property
    def done(self) -> Array:
        """Return whether each episode is over; a new array."""
        done: Array = self.ended | self.stopped
        return done

    def step(self, ranges: bool = True, where: Array | None = None) -> int:
        """Run a tick of the worlds with `actions`; those that ended before are reset.

        Args:
            ranges: Whether to check the ranges of the actions, those of all worlds for any `where`.
            where: The worlds to step, bool (worlds,); None: all. The tables of the others do not change.

        Returns:
            NOT_RUNNING, HAS_ENDED or OUT_OF_RANGE for a refusal, which changes nothing; otherwise FAULT, DONE or both,
            if some world has a fault or some episode is over.
        """
        if ranges is not self._ranges:
            self._ranges = ranges
            self._block[WORDS.index("ranges")] = ranges
        if where is not None or not self._all:
            self._all = where is None
            self._where[:] = True if where is None else where
            last = np.moveaxis(self.worlds.actions, 0, -1) + self._zeros
            self.actions[~self._where] = last[~self._where]  # the actions in their tables, which are kept
        if self._whole is None or self.observers:
            return int(self._part(BEGIN)) or self._run()
        flags = self._whole()
        if flags < 0 and self._tick is not None:
            raise self.worlds.overflow(self._tick.error())
        return flags

    def reset(self, where: Array, keys: tuple[Array, Array, Array] | None = None) -> int:
        """Begin new episodes in the worlds `where`, bool (worlds,). Returns the result of `step`.

        keys: seeds and worlds, (worlds,) each, that key random numbers from now on; and whether a world gets them.
        """
        self.mode[:] = np.where(where, RESET, SKIP)
        return self._run(keys)

    def close(self) -> None:
        """Release the threads, and close the observers."""
        self.worlds.close()
        for observer in self.observers:
            observer.close()

    def _run(self, keys: tuple[Array, Array, Array] | None = None) -> int:
        """Run the tick of the worlds by `mode`. If it is cut short, as by Ctrl-C, they are no longer running."""
        observers = self.observers = [each for each in self.observers if each.recording]
        for observer in observers:
            observer.check(self.mode)
        ran, how = self.mode != SKIP, FINISH | CUT_SHORT
        try:
            if (stale := ran & ~self.running).any():
                for column in self._buffers:
                    column[stale] = 0
            self.running[ran] = False
            if keys:
                seeded = ran & keys[2]
                self.worlds.seed(keys[0][seeded], keys[1][seeded], seeded)
            for observer in observers:
                observer.before(self.mode)
            self.worlds.run(self.mode)
            how = FINISH
        finally:
            flags = int(self._part(how))
        try:
            for observer in observers:
                observer.after(self.mode)
        except Exception:  # the tick is complete, and the next step resets the worlds that ended in it
            self.running[ran] = True
            raise
        return flags


def _place(column: Array) -> tuple[int, int, int]:
    """Return a column as an entry of a list of columns, see compilation.compiled_step."""
    return column.ctypes.data, column.strides[0], column[0].nbytes
