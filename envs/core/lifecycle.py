"""The episodes of worlds: beginnings and ends, worlds that cannot begin or continue, and the events of a step."""

import contextlib
import logging
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.components import Death, End, Fault, Reward, Unplaced
from outlast.ecs import SKIP, Clock, Stepper, Worlds
from outlast.ecs.declarations.event import EventMemory, entries
from outlast.ecs.kernels.cache_files import cache_folder

from ..errors import FaultError, NotResetError, ScenarioError
from .validation import Array

LOGGER = logging.getLogger("outlast")
DEATHS, LEVEL = logging.getLogger("outlast.deaths"), logging.INFO
# deaths are logged if this logger is set to INFO; setting "outlast" to INFO is not enough
DEATHS.setLevel(logging.WARNING)


def check_playable(worlds: Worlds, name: str) -> None:
    """Raise ScenarioError unless the worlds of the scenario of that name have rewards and ends."""
    if missing := [signal.__name__ for signal in (Reward, End) if signal not in worlds]:
        raise ScenarioError(
            f"{name}: no module brings {' and '.join(missing)}; an environment needs the modules rewards and ending"
        )


def check_faults(worlds: Worlds, first_world: int) -> None:
    """Raise FaultError if in the last tick a body got a number that the physics cannot handle, or found no place."""
    check_places(worlds, first_world)
    if Fault in worlds and (faulty := (worlds[Fault].physics[:, 0] != 0) & (worlds.mode != SKIP)).any():
        w = int(faulty.argmax())
        raise FaultError(
            f"world {first_world + w}: a body has a position, speed, size or mass that physics cannot take (NaN, a "
            "million metres and more, no size, or no mass where it moves); a mechanic wrote it into Body, Shape or "
            "Solid. Reset the world: it starts afresh"
        )


def check_places(worlds: Worlds, first_world: int) -> None:
    """Raise FaultError if a body of some world found no place at reset."""
    if Unplaced in worlds and worlds[Unplaced].bodies.any():
        w = int(worlds[Unplaced].bodies[:, 0].argmax())
        raise FaultError(
            f"world {first_world + w}: {worlds[Unplaced].bodies[w, 0]} bodies found no free place among the walls (or "
            "in their start areas) at reset, and overlap something; take fewer or smaller agents, items and boxes, or "
            "leave more floor"
        )


class EpisodeTracker(Stepper):
    """The state of episodes, running or ended and waiting for a reset; takes steps and resets."""

    def __init__(self, worlds: Worlds, autoreset: AutoresetMode) -> None:
        """Create it; none of the worlds is running yet."""
        super().__init__(
            worlds,
            actions=np.zeros((worlds.count, worlds.dims["agents"], len(worlds.layout.actions)), np.int64),
            ends=worlds[End],
            faults=[column for fault in (Fault, Unplaced) if fault in worlds for column in worlds[fault]],
            resets=autoreset is not AutoresetMode.DISABLED,
            at_once=autoreset is AutoresetMode.SAME_STEP,
        )
        self.set_states = np.zeros(worlds.count, np.int64)  # number of states that were set in each world

    @property
    def masks(self) -> dict[str, Array]:
        """Return the further arrays of saved states, bool (worlds,) each, by their names there."""
        return {"over": self.ended, "started": self.running}

    @contextlib.contextmanager
    def overwritten(self, where: Any) -> Iterator[dict[str, Array]]:
        """Stop all worlds while the worlds `where` are overwritten, since Ctrl-C may leave a world half-written.

        Yields `masks` to overwrite; "started" takes effect only when everything else is written.
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

    def check_going(self, where: Array | None) -> None:
        """Raise NotResetError unless all worlds, or those of the mask `where`, are in a running episode."""
        some = np.ones(len(self.done), bool) if where is None else where
        self.check_running("step", some)
        if (done := self.done & some).any():
            raise NotResetError(
                f"worlds {np.flatnonzero(done)[:8].tolist()} have ended and "
                'autoreset is disabled; reset them first: reset(options={"reset_mask": terminated | truncated})'
            )


@contextlib.contextmanager
def announce_compilation(worlds: Worlds, name: str) -> Iterator[None]:
    """Log at level INFO how many systems are compiled, and how long it took (the cache logs the progress)."""
    if not (count := len(worlds.uncompiled)):
        yield
        return
    kept = f"kept in {folder}" if (folder := cache_folder()) else "not kept"
    systems = f"{count} system{'s' * (count > 1)}"
    LOGGER.info("compiling %s of %s for this machine; machine code is %s", systems, name, kept)
    start = time.perf_counter()
    yield
    LOGGER.info("compiled in %.0f s", time.perf_counter() - start)


class StepEvents:
    """The events of every world's last step, even if the world was reset right after it."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds, self.some = worlds, False  # some: whether any events are kept
        self._kept = np.zeros(worlds.count, bool)
        self._memory = worlds.event_memory.of(slice(0))
        self._clock = np.empty((0, 2), np.int64)

    def keep(self, where: Array) -> None:
        """Keep the events of the worlds `where`, bool (worlds,), which are about to be reset."""
        clock = self._worlds[Clock]
        self._kept = where.copy()
        self._memory = self._worlds.event_memory.of(where)
        self._clock = np.stack([clock.episode[where, 0], clock.tick[where, 0]], 1)
        self.some = len(self._clock) > 0

    def forget(self, where: Any = slice(None)) -> None:
        """Drop the kept events of the worlds `where` (mask, indices or slice), which have continued from that step."""
        if not self.some:
            return
        left = self._kept.copy()
        left[where] = False
        still = left[self._kept]
        self._kept, self._memory, self._clock = left, self._memory.of(still), self._clock[still]
        self.some = len(self._clock) > 0

    def read(self) -> dict[str, Array]:
        """Return the events by name; see ecs.Worlds.entries."""
        if not self.some:
            return self._worlds.events()
        clock, now = self._worlds[Clock], self._worlds.event_memory
        memory = EventMemory(now.counts.copy(), now.lists.copy())
        episode, tick = clock.episode[:, 0].copy(), clock.tick[:, 0].copy()
        memory.counts[self._kept], memory.lists[self._kept] = self._memory
        episode[self._kept], tick[self._kept] = self._clock.T
        times = (np.arange(self._worlds.count), episode, tick)
        kinds = self._worlds.layout.events
        return {kind.name: entries(kind, kinds, memory, times) for kind in kinds}


def log_deaths(worlds: Worlds, first_world: int = 0) -> None:
    """Log the deaths of the last tick at level INFO: world, tick, who, cause and the side that did it."""
    # "no damage" is last, as its number is -1
    causes = [*worlds.layout.labels["damage_type"], "no damage"]
    for death in worlds.entries(Death):
        if worlds.mode[death["world"]] == SKIP:  # this world took no tick, so the entry is an old one
            continue
        by = f" by side {death['side']}" if death["side"] >= 0 else ""
        w, cause = first_world + death["world"], causes[death["damage_type"]]
        who = worlds.layout.entity_names[death["agent"]]
        DEATHS.log(LEVEL, "world %d, tick %d: %s died of %s%s", w, death["tick"], who, cause, by)
