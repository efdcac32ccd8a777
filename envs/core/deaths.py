"""A log of deaths, by the logger "outlast.deaths" at level INFO."""

import logging

import numpy as np

from outlast.components import Death
from outlast.ecs import Clock, Worlds

LOGGER = logging.getLogger("outlast.deaths")
LOGGER.setLevel(logging.WARNING)  # set INFO here to see deaths; that of "outlast" is not enough


def log_deaths(worlds: Worlds, first_world: int = 0) -> None:
    """Log the deaths of the last tick at level INFO: world, tick, agent, cause and the side that did it."""
    if not LOGGER.isEnabledFor(logging.INFO):
        return
    death, ticks, agents = worlds[Death], worlds[Clock].tick[:, 0], worlds.span("agent")
    for w, i in np.argwhere(death.now[:, agents]):
        cause, source = worlds.layout.damage_types[death.damage_type[w, agents][i]], death.source[w, agents][i]
        by = f" by side {source}" if source >= 0 else ""
        LOGGER.info("world %d, tick %d: agent %d died of %s%s", first_world + w, ticks[w], i, cause, by)
