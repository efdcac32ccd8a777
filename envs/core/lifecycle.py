"""The episodes of worlds: where they begin and end, and worlds that cannot begin or go on."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from outlast.components import End, Fault, Reward, Unplaced
from outlast.ecs import Worlds

from ..errors import FaultError, NotResetError, RecordingError, ScenarioError

Array = np.ndarray[Any, Any]


def check_playable(worlds: Worlds, name: str) -> None:
    """ScenarioError unless the worlds of the scenario of that name have rewards and ends."""
    if missing := [signal.__name__ for signal in (Reward, End) if signal not in worlds]:
        raise ScenarioError(
            f"{name}: no module brings {' and '.join(missing)}; an environment needs the modules rewards and ending"
        )


def check_faults(worlds: Worlds) -> None:
    """FaultError if a body of some world got a number that physics cannot take, or found no place at reset."""
    check_places(worlds)
    if Fault in worlds and worlds[Fault].physics.any():
        w = int(worlds[Fault].physics[:, 0].argmax())
        raise FaultError(
            f"world {w}: a body has a position, speed or size that physics cannot take (NaN, or 1e6 and more); "
            "some mechanic wrote it into Body or Shape. Reset the world: it starts afresh"
        )


def check_places(worlds: Worlds) -> None:
    """FaultError if a body of some world found no place at reset."""
    if Unplaced in worlds and worlds[Unplaced].bodies.any():
        w = int(worlds[Unplaced].bodies[:, 0].argmax())
        raise FaultError(
            f"world {w}: {worlds[Unplaced].bodies[w, 0]} bodies found no free place among the walls (or in their start "
            "areas) at reset, and overlap something; take fewer or smaller agents, items and boxes, or leave more floor"
        )


class EpisodeTracker:
    """Which worlds are in an episode, and which have ended and wait for a reset. Masks, bool (worlds,).

    running: started, and not interrupted in mid-tick. ended: by their scenario's rule or at its time limit.
    stopped: by the `stops` of `SurvivalVectorEnv.stop_when`. done: ended or stopped.
    set_states: how often each world went on from a state that was set, int64 (worlds,).
    at_once: the step that ends an episode also begins the next one, and is cut short without that.
    """

    def __init__(self, worlds: Worlds, at_once: bool) -> None:
        self._worlds, self._end, self._at_once = worlds, worlds[End], at_once
        self.running, self.ended, self.stopped = (np.zeros(worlds.count, bool) for _ in range(3))
        self.set_states = np.zeros(worlds.count, np.int64)
        self._buffers = [
            column for component in worlds.components if not component.packed for column in worlds[component]
        ]

    @property
    def done(self) -> Array:
        """Which episodes are over, a new array."""
        done: Array = self.ended | self.stopped
        return done

    def run(self, runner: Any, mode: Array, some: Array | None = None, keys: tuple[Array, Array] | None = None) -> None:
        """Take the worlds through the tick. If it is cut short, as by Ctrl-C, those that took part no longer run.

        some: the worlds that take part, bool (worlds,); without it, all, which are running. keys: seeds and worlds,
        (worlds,) each, that key their random numbers from now on.
        """
        before, ran = self.running.copy(), slice(None) if some is None else some
        if some is not None and not before[some].all():
            self._clear(some & ~before)
        self.running[ran] = False
        try:
            if keys:
                self._worlds.seed(keys[0][ran], keys[1][ran], ran)
            runner.run(mode)
        except RecordingError:  # ahead of the run, or after it
            self.running[:] = before
            raise
        finally:
            np.logical_or(self._end.terminated[:, 0], self._end.truncated[:, 0], out=self.ended)
        self.stopped[ran] = False
        self.running[ran] = ~self.ended[ran] if self._at_once else True

    def _clear(self, where: Array) -> None:
        """Zero the buffers that systems write only where something changes (see components.sight)."""
        for column in self._buffers:
            column[where] = 0

    @contextlib.contextmanager
    def overwritten(self, where: Any) -> Iterator[None]:
        """While the worlds `where` and their masks are overwritten, none is running: Ctrl-C may leave half a world."""
        before = self.running.copy()
        self.running[:] = False
        try:
            yield
        except Exception:  # a refusal, ahead of it
            self.running[:] = before
            raise
        before[where] = self.running[where]
        self.running[:] = before
        self.stopped[where] = False
        self.set_states[where] += 1

    def check(self, resets: bool) -> None:
        """NotResetError unless a step can be taken. resets: worlds that have ended are reset in it."""
        if not self.running.all():
            raise NotResetError(
                f"step() before reset(): {int((~self.running).sum())} worlds have not started; reset them "
                "(worlds whose last step was interrupted have to start again, too)"
            )
        if not resets and (done := self.done).any():
            raise NotResetError(
                f"worlds {np.flatnonzero(done)[:8].tolist()} have ended and autoreset is disabled; "
                'reset them first: reset(options={"reset_mask": terminated | truncated})'
            )
