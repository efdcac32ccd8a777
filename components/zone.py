"""The safe zone."""

from typing import Any

from outlast.ecs import Array, Field, Observation, Singleton, column, kernel

from .body import PLACE, half_room


class Zone(Singleton):
    """The present safe circle, and the next one, towards which it moves. Radius 0: void, no place is safe."""

    x: Array = column("f4")  # metres
    y: Array = column("f4")
    radius: Array = column("f4")
    next_x: Array = column("f4")
    next_y: Array = column("f4")
    next_radius: Array = column("f4")
    centres: Array = column("f4", "zones", 2)  # the centres of all phases, drawn at reset


class ZoneView(Observation):
    """Present centre and radius, next centre and radius; the same row for every agent."""

    zone: Array = column(
        "f4",
        "agents",
        fields=(
            *PLACE,
            Field("radius", "m", scale=half_room),
            Field("next_x", "m", scale=half_room),
            Field("next_y", "m", scale=half_room),
            Field("next_radius", "m", scale=half_room),
        ),
    )


@kernel
def outside(zone: Any, body: Any, e: int) -> bool:
    """Return whether the centre of `e` is beyond the rim of the zone; everything is outside a void zone."""
    x, y = body.x[e] - zone.x[0], body.y[e] - zone.y[0]
    beyond: bool = x * x + y * y > zone.radius[0] * zone.radius[0] or zone.radius[0] == 0
    return beyond
