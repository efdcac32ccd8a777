"""The episodes of worlds: when they begin and end, and which worlds cannot begin or go on."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.components import End, Fault, Reward, Unplaced
from outlast.ecs import RESET, SKIP, STEP, Worlds

from ..errors import FaultError, NotResetError, RecordingError, ScenarioError
from .step_functions import COMPLETED, FAILED, HAS_ENDED, LEFT, NOT_RUNNING, OUT_OF_RANGE, RANGES, WORDS

Array = np.ndarray[Any, Any]


def check_playable(worlds: Worlds, name: str) -> None:
    """ScenarioError unless the worlds of the scenario of that name have rewards and ends."""
    if missing := [signal.__name__ for signal in (Reward, End) if signal not in worlds]:
        raise ScenarioError(
            f"{name}: no module brings {' and '.join(missing)}; an environment needs the modules rewards and ending"
        )


def check_faults(worlds: Worlds, first_world: int) -> None:
    """FaultError if in the last tick a body got a number that the physics cannot handle, or found no place."""
    check_places(worlds, first_world)
    if Fault in worlds and (faulty := (worlds[Fault].physics[:, 0] != 0) & (worlds.mode != SKIP)).any():
        w = int(faulty.argmax())
        raise FaultError(
            f"world {first_world + w}: a body has a position, speed, size or mass that physics cannot take (NaN, a "
            "million metres and more, no size, or no mass where it moves); a mechanic wrote it into Body, Shape or "
            "Solid. Reset the world: it starts afresh"
        )


def check_places(worlds: Worlds, first_world: int) -> None:
    """FaultError if a body of some world found no place at reset. first_world: the number of the first one."""
    if Unplaced in worlds and worlds[Unplaced].bodies.any():
        w = int(worlds[Unplaced].bodies[:, 0].argmax())
        raise FaultError(
            f"world {first_world + w}: {worlds[Unplaced].bodies[w, 0]} bodies found no free place among the walls (or "
            "in their start areas) at reset, and overlap something; take fewer or smaller agents, items and boxes, or "
            "leave more floor"
        )


class EpisodeTracker:
    """Tracks which worlds are in an episode and which have ended and wait for a reset, and takes steps and resets.

    Attributes:
        running: Which worlds have started and were not interrupted in mid-tick: bool (worlds,).
        ended: Which have ended by their scenario's rule or at its time limit: bool (worlds,).
        stopped: Which were stopped by the `stops` of `SurvivalVectorEnv.stop_when`: bool (worlds,).
        actions: What the agents do in the next step, int64 (worlds, agents, actions), numbered as for learners.
        mode: The mode of each world in the last tick: SKIP, STEP or RESET, int8 (worlds,).
        flags: What `step_functions.finish` returned for the last tick.
        set_states: How often each world went on from a state that was set, int64 (worlds,).
    """

    def __init__(self, worlds: Worlds, sizes: Array, zeros: Array, autoreset: AutoresetMode) -> None:
        """Make it; no world is running yet.

        Args:
            worlds: Worlds that were made with the FUNCTIONS and PARTS of step_functions.
            sizes: How many values each action has, (actions,).
            zeros: Which of them does nothing, (actions,).
            autoreset: When a world that ended begins its next episode.
        """
        self._worlds, count = worlds, worlds.count
        self.running, self.ended, self.stopped = (np.zeros(count, bool) for _ in range(3))
        self.mode, self.set_states, self.flags = worlds.mode, np.zeros(count, np.int64), 0
        self.actions = np.zeros((count, worlds.dims["agents"], len(sizes)), np.int64)
        self._buffers = [
            column for component in worlds.components if not component.packed for column in worlds[component]
        ]
        end, taken = worlds[End], worlds.actions
        self._arrays = {  # kept here, as the words below are their addresses
            "actions": self.actions,
            "sizes": sizes.astype(np.int64),
            "zeros": zeros.astype(np.int64),
            "taken": taken,
            "mode": self.mode,
            "running": self.running,
            "ended": self.ended,
            "stopped": self.stopped,
            "terminated": end.terminated,
            "truncated": end.truncated,
            "rewards": worlds[Reward].reward,
            **({"fault": worlds[Fault].physics} if Fault in worlds else {}),
            **({"unplaced": worlds[Unplaced].bodies} if Unplaced in worlds else {}),
        }
        words = {name: array.ctypes.data for name, array in self._arrays.items()}
        words |= {f"{name}_stride": self._arrays[name].strides[0] for name in ("fault", "unplaced") if name in words}
        words |= {"worlds": count, "agents": self.actions.shape[1], "columns": self.actions.shape[2]}
        words |= {"taken_bytes": taken.itemsize, "ranges": 1, "resets": autoreset is not AutoresetMode.DISABLED}
        words["at_once"] = autoreset is AutoresetMode.SAME_STEP
        self._block = np.array([words.get(name, 0) for name in WORDS], np.int64)
        self._address, self._ranges = int(self._block.ctypes.data), True

    def load(self) -> None:
        """Load or compile everything that runs in a step."""
        self._begin, self._finish = map(self._worlds.function, ("begin", "finish"))
        self._whole = self._worlds.call_with_tick("step", "play")

    @property
    def masks(self) -> dict[str, Array]:
        """What saved states hold besides the tables, bool (worlds,) each, by the names used there."""
        return {"over": self.ended, "started": self.running}

    @property
    def done(self) -> Array:
        """Which episodes are over; a new array."""
        done: Array = self.ended | self.stopped
        return done

    def step(self, runner: Any, ranges: bool) -> int:
        """Take all worlds, which must be running, through a tick with `actions`; worlds that ended are reset.

        Args:
            runner: What runs them: the worlds, or a recorder of them.
            ranges: Whether to check the ranges of actions.

        Returns:
            OUT_OF_RANGE if actions are out of range, and nothing has changed; otherwise `flags`.

        Raises:
            NotResetError: Worlds are not running, or have ended under DISABLED.
        """
        if ranges is not self._ranges:
            self._ranges = ranges
            self._block[RANGES // 8] = ranges
        if self._whole is not None and runner is self._worlds:
            found = self._whole(self._address)
        elif not (found := self._begin(self._address)):
            self.run(runner)
            return self.flags
        if found & (NOT_RUNNING | HAS_ENDED):
            self._refuse()
        if not found & OUT_OF_RANGE:
            self.flags = found
        return int(found)

    def step_some(self, runner: Any, some: Array) -> int:
        """Take only the worlds `some`, bool (worlds,), through a step; their actions must be in range.

        The tables of the other worlds keep their rewards and events, which a recording has, too.
        """
        if not self.running[some].all() or self.done[some].any():
            self._refuse(some)
        self._worlds.actions[:, some] = np.moveaxis(self.actions[some] - self._arrays["zeros"], 2, 0)
        self.mode[:] = np.where(some, STEP, SKIP)
        self.run(runner)
        return self.flags

    def reset(self, runner: Any, some: Array, keys: tuple[Array, Array, Array] | None = None) -> None:
        """Begin new episodes in the worlds `some`, bool (worlds,).

        keys: seeds and worlds, (worlds,) each, that key random numbers from now on, and the worlds that get them, bool.
        """
        self.mode[:] = np.where(some, RESET, SKIP)
        if keys is not None and runner is not self._worlds and runner.recording:
            runner.check(self.mode)  # raises before worlds are seeded
        if not self.running[some].all():
            self._clear(some & ~self.running)
        self.run(runner, keys)

    def run(self, runner: Any, keys: tuple[Array, Array, Array] | None = None) -> None:
        """Take the worlds through the tick by their `mode`. If it is cut short, by Ctrl-C, say, they no longer run."""
        before, ran, outcome = self.running.copy(), self.mode != SKIP, FAILED
        self.running[ran] = False
        try:
            if keys:
                seeded = ran & keys[2]
                self._worlds.seed(keys[0][seeded], keys[1][seeded], seeded)
            runner.run(self.mode)
            outcome = COMPLETED
        except RecordingError:  # raised before or after the tick, so no world is half-way
            self.running[:], outcome = before, LEFT
            raise
        finally:
            self.flags = self._finish(self._address, outcome)

    def _clear(self, where: Array) -> None:
        """Zero the buffers that systems only write where something changes (see components.sight)."""
        for column in self._buffers:
            column[where] = 0

    @contextlib.contextmanager
    def overwritten(self, where: Any) -> Iterator[dict[str, Array]]:
        """Let no world run while the worlds `where` are overwritten, as Ctrl-C may leave a world half-written.

        Yields:
            `masks` to overwrite; "started" takes effect only when everything else is written.
        """
        before, masks = self.running.copy(), self.masks | {"started": self.running.copy()}
        self.running[:] = False
        try:
            yield masks
        except Exception:  # refused before anything was overwritten
            self.running[:] = before
            raise
        self.set_states[where] += 1
        self.running[:] = masks["started"]

    def check_running(self, call: str, where: Any = slice(None)) -> None:
        """Raise NotResetError for `call`, such as "step", unless all worlds, or those `where`, are in an episode."""
        if not self.running[where].all():
            raise NotResetError(
                f"{call}() before reset(): {int((~self.running[where]).sum())} worlds have not started; reset them "
                "(worlds whose last step was interrupted have to start again, too)"
            )

    def _refuse(self, where: Any = True) -> None:
        """Raise NotResetError for a step of the worlds `where`, bool (worlds,)."""
        self.check_running("step", np.broadcast_to(where, self.running.shape))
        raise NotResetError(
            f"worlds {np.flatnonzero(self.done & where)[:8].tolist()} have ended and autoreset is disabled; "
            'reset them first: reset(options={"reset_mask": terminated | truncated})'
        )
