"""The naive form of lidar: distances along rays, float64, one ray and one body at a time."""

import math

from tests.helpers.naive_mechanics import entry
from tests.helpers.naive_world import TOLERANCE, NaiveEntity, World

TARGETS = {"walls": ("wall", "inner_wall"), "solids": ("wall", "inner_wall", "agent", "box")}
TARGETS["bodies"] = (*TARGETS["solids"], "heal", "box_item")


def directions(world: World, me: NaiveEntity) -> list[float]:
    """Angles of the rays of an agent, radians in the room's frame, from right to left."""
    rays, angle = world.numbers["lidar_rays"], world.own(me)["lidar_angle"]
    return [me.angle - angle / 2 + (k + 0.5) / rays * angle for k in range(rays)]


def distance(world: World, me: NaiveEntity, angle: float) -> tuple[float, float]:
    """The shortest and the longest distance that a ray may read if the sides of bodies are off by what float32 loses.

    This loss grows with the square of the distance to a circle, as Box2D's formula has a difference of fourth powers.
    For a ray that grazes a body, the two distances are far from each other.
    """
    if not me.here:
        return 0.0, 0.0
    targets = [entity for entity in world.live(*TARGETS[world.numbers["lidar_targets"]]) if entity is not me]
    depth = world.own(me)["lidar_depth"]
    ray, lost = (depth * math.cos(angle), depth * math.sin(angle)), TOLERANCE * max(1.0, depth / 10) ** 2
    found = [
        depth * min([1.0, *(entry((me.x, me.y), ray, target, offset) for target in targets)])
        for offset in (-lost, 0.0, lost)
    ]
    return min(found) - lost, max(found) + lost
