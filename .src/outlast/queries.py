"""What mechanics can ask about bodies: who is near, how far away, first on a ray, in sight (docs/mechanic.md).

>>> from outlast.queries import Bodies, within
"""

from .systems.geometry.bodies import Bodies, in_box, near, on_ray, refresh
from .systems.geometry.queries import (
    around,
    distance,
    distance_to,
    first_on_ray,
    line_of_sight,
    nearest,
    overlap,
    within,
)
from .systems.geometry.rays import NO_HIT, raycast_entity

__all__ = [
    "NO_HIT",
    "Bodies",
    "around",
    "distance",
    "distance_to",
    "first_on_ray",
    "in_box",
    "line_of_sight",
    "near",
    "nearest",
    "on_ray",
    "overlap",
    "raycast_entity",
    "refresh",
    "within",
]
