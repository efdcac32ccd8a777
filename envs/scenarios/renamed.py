"""Names that have changed since earlier versions: old names still work, with a warning if a user types them."""

import sys
import warnings
from collections.abc import Collection
from typing import Any

NUMBERS = {
    "drop_radius": "death_drop_radius",
    "drop_scatter": "death_drop_scatter",
    "give_nearest": "give_last_nearest",
    "give_passes_on": "give_last_passes_on",
    "give_reach": "give_last_reach",
    "health_limit": "mortality_limit",
    "motors_speed": "steering_speed",
    "motors_spin": "steering_spin",
    "physics_bridge": "physics_backend",
    "sides_count": "teams_count",
    "spawn_cells": "spawn_grid_cells",
    "zone_centres": "safe_zone_centres",
    "zone_harm": "safe_zone_damage",
    "zone_radii": "safe_zone_radii",
    "zone_shrink": "safe_zone_shrink",
    "zone_stand": "safe_zone_stand",
}
MECHANICS = {  # old name by present name, as two of them may have had the same old name
    "death_drop": "drop",
    "free_for_all": "sides",
    "give_last": "give",
    "mortality": "health",
    "safe_zone": "zone",
    "spawn_grid": "spawn",
    "steering": "motors",
    "teams": "sides",
}
CLASSES = {
    "outlast.systems.drop.DeathDrop": "outlast.systems.death_drop.DeathDrop",
    "outlast.systems.give.GiveLast": "outlast.systems.give_last.GiveLast",
    "outlast.systems.health.Mortality": "outlast.systems.mortality.Mortality",
    "outlast.systems.motors.Steering": "outlast.systems.steering.Steering",
    "outlast.systems.physics.Contacts": "outlast.systems.physics.Physics",
    "outlast.systems.pickup.AutoPickup": "outlast.systems.pickup.Pickup",
    "outlast.systems.sides.FreeForAll": "outlast.systems.free_for_all.FreeForAll",
    "outlast.systems.sides.Teams": "outlast.systems.teams.Teams",
    "outlast.systems.spawn.SpawnGrid": "outlast.systems.spawn_grid.SpawnGrid",
    "outlast.systems.zone.SafeZone": "outlast.systems.safe_zone.SafeZone",
}
COMPONENTS = {"Death": "Died"}  # in recordings
ARRAYS = {  # in states
    "outlast.components.agent.SelfView.me": "outlast.components.agent.SelfView.own",
    "outlast.components.sight.Told.filled": "outlast.components.sight.ObservationMasks.filled",
    "outlast.components.sight.Told.masks": "outlast.components.sight.ObservationMasks.mask",
    "outlast.components.sight.Told.stale": "outlast.components.sight.ObservationMasks.dirty",
}


# numbers that were added: a number that files already had then, and the value that the new one has in such files
ADDED = {
    "inventory_capacity": ("inventory_slots", 0),
    "room_height": ("room_size", 0.0),
    "room_width": ("room_size", 0.0),
    "teams_sizes": ("teams_count", []),
}


def current_numbers(given: dict[str, Any], known: Collection[str] = ()) -> dict[str, Any]:
    """Return the numbers of a file by current names, with those that did not exist yet; see `current`."""
    found = current(given, NUMBERS, known)
    return found | {new: value for new, (old, value) in ADDED.items() if old in found and new not in found}


def current(given: dict[str, Any], table: dict[str, str], known: Collection[str] = ()) -> dict[str, Any]:
    """Return the same by current names. A key that is `known` stays, as a mechanic of the user's can have such a name.

    Args:
        given: Values by name, from a file.
        table: Earlier names and the current ones.
        known: Names that are current wherever `given` is used.
    """
    return {
        name if name in known or table.get(name, name) in given else table.get(name, name): value
        for name, value in given.items()
    }


def warn(old: str, new: str, text: str = "the name {} is now {}") -> None:
    """Issue a DeprecationWarning at the line outside outlast that uses the old name."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals["__name__"].partition(".")[0] == "outlast":
        frame, level = frame.f_back, level + 1
    warnings.warn(text.format(old, new), DeprecationWarning, stacklevel=level)
