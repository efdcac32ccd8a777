"""Worlds that cannot begin, or cannot go on."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from outlast.components import End, Fault, Reward
from outlast.ecs import Worlds

from ..errors import FaultError, NotResetError, RecordingError
from ..scenarios.scenario import ScenarioError

Array = np.ndarray[Any, Any]


def check_playable(worlds: Worlds, name: str) -> None:
    """ScenarioError unless the worlds of the scenario of that name tell rewards and ends."""
    if missing := [signal.__name__ for signal in (Reward, End) if signal not in worlds]:
        raise ScenarioError(
            f"{name}: no module brings {' and '.join(missing)}; an environment needs the modules rewards and ending"
        )


def check_faults(worlds: Worlds) -> None:
    """FaultError if a body of some world got a number that physics cannot take."""
    if Fault in worlds and worlds[Fault].physics.any():
        w = int(worlds[Fault].physics[:, 0].argmax())
        raise FaultError(
            f"world {w}: a body has a position, speed or size that physics cannot take (NaN, or 1e6 and more); "
            "some mechanic wrote it into Body or Shape. Reset the world: it starts afresh"
        )


class Progress:
    """How far the worlds are: which have started, and which have ended since and wait for a reset. Masks (worlds,).

    at_once: the step that ends an episode also begins the next one, and is cut short without that.
    """

    def __init__(self, worlds: Worlds, at_once: bool) -> None:
        self._worlds, self._end, self._at_once = worlds, worlds[End], at_once
        self.over, self.started = np.zeros(worlds.count, bool), np.zeros(worlds.count, bool)
        self._buffers = [
            column for component in worlds.components if not component.packed for column in worlds[component]
        ]

    def run(self, runner: Any, mode: Array, some: Array | None = None, keys: tuple[Array, Array] | None = None) -> None:
        """Take the worlds through the tick. Those of a run that is cut short, as by Ctrl-C, have not started.

        some: the worlds that run, bool (worlds,); without it, all, which have started. keys: seeds and worlds,
        (worlds,) each, that key their random numbers from now on.
        """
        before, ran = self.started.copy(), slice(None) if some is None else some
        if some is not None and not before[some].all():
            self._clear(some & ~before)
        self.started[ran] = False
        try:
            if keys:
                self._worlds.seed(keys[0][ran], keys[1][ran], ran)
            runner.run(mode)
        except RecordingError:  # ahead of the run, or after it
            self.started[:] = before
            raise
        finally:
            np.logical_or(self._end.terminated[:, 0], self._end.truncated[:, 0], out=self.over)
        self.started[ran] = ~self.over[ran] if self._at_once else True

    def _clear(self, where: Array) -> None:
        """What systems write only where it changes (see components.sight.Told) begins with nothing."""
        for column in self._buffers:
            column[where] = 0

    @contextlib.contextmanager
    def overwritten(self, where: Any) -> Iterator[None]:
        """While the worlds `where` are, these two masks included, none has started: Ctrl-C may leave half of one."""
        before = self.started.copy()
        self.started[:] = False
        try:
            yield
        except Exception:  # a refusal, ahead of it
            self.started[:] = before
            raise
        before[where] = self.started[where]
        self.started[:] = before

    def check(self, resets: bool) -> None:
        """NotResetError unless a step can be taken. resets: worlds that have ended are reset in it."""
        if not self.started.all():
            raise NotResetError(
                f"step() before reset(): {int((~self.started).sum())} worlds have not started; reset them "
                "(worlds whose last step was interrupted have to start again, too)"
            )
        if not resets and self.over.any():
            raise NotResetError(
                f"worlds {np.flatnonzero(self.over)[:8].tolist()} have ended and autoreset is disabled; "
                'reset them first: reset(options={"reset_mask": terminated | truncated})'
            )
