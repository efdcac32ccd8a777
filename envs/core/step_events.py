"""The events of an environment's last step; and a log of deaths, by the logger "outlast.deaths" at level INFO."""

import logging
from typing import Any

import numpy as np

from outlast.components import Death
from outlast.ecs import SKIP, Clock, Worlds
from outlast.ecs.declarations.event import EventMemory, entries

from .validation import Array

DEATHS, LEVEL = logging.getLogger("outlast.deaths"), logging.INFO
# deaths are logged if this logger is set to INFO; setting "outlast" to INFO is not enough
DEATHS.setLevel(logging.WARNING)


class StepEvents:
    """The events of every world's last step, even if the world was reset right after it.

    Attributes:
        some: Whether any events are kept.
    """

    def __init__(self, worlds: Worlds) -> None:
        self._worlds, self.some = worlds, False
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
    if not DEATHS.isEnabledFor(LEVEL):
        return
    # "no damage" is last, as its number is -1
    causes = [*worlds.layout.labels["damage_type"], "no damage"]
    for death in worlds.entries(Death):
        if worlds.mode[death["world"]] == SKIP:  # this world took no tick, so the entry is an old one
            continue
        by = f" by side {death['side']}" if death["side"] >= 0 else ""
        w, cause = first_world + death["world"], causes[death["damage_type"]]
        who = worlds.layout.entity_names[death["agent"]]
        DEATHS.log(LEVEL, "world %d, tick %d: %s died of %s%s", w, death["tick"], who, cause, by)
