"""A log of deaths, written by the logger "outlast.deaths" at level INFO."""

import logging

from outlast.components import Death
from outlast.ecs import SKIP, Worlds

LOGGER = logging.getLogger("outlast.deaths")
LEVEL = logging.INFO
# deaths are logged if this logger is set to INFO; setting "outlast" to INFO is not enough
LOGGER.setLevel(logging.WARNING)


def log(worlds: Worlds, first_world: int = 0) -> None:
    """Log the deaths of the last tick at level INFO: world, tick, who, cause and the side that did it."""
    if not LOGGER.isEnabledFor(LEVEL):
        return
    # "no damage" is last, as its number is -1
    causes = [*worlds.layout.labels["damage_type"], "no damage"]
    for death in worlds.entries(Death):
        if worlds.mode[death["world"]] == SKIP:  # this world took no tick, so the entry is an old one
            continue
        by = f" by side {death['side']}" if death["side"] >= 0 else ""
        w, cause = first_world + death["world"], causes[death["damage_type"]]
        who = worlds.layout.entity_names[death["agent"]]
        LOGGER.log(LEVEL, "world %d, tick %d: %s died of %s%s", w, death["tick"], who, cause, by)
