"""Lidar: a line along each ray of an agent, up to what it hits. Not shown by default."""

import math
from collections.abc import Collection
from dataclasses import dataclass

from outlast import systems
from outlast.components import Body, LidarView, Side

from ..canvas import Canvas, Point
from ..scene import Scene
from ..style import SIZES, of_side
from .layer import Layer, ZOrder


@dataclass(frozen=True)
class LidarLayer(Layer):
    """The rays of living agents: all of them, or those with the numbers `agents`."""

    zorder = ZOrder.SIGHT
    needs = (systems.Lidar, LidarView, Side)
    agents: Collection[int] | None = None
    width: float = SIZES.ray

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw the rays of agents that are not blind."""
        body, living = scene.body, {*scene.living(Body, Side)}
        for i, e in enumerate(scene.rows(Side)):
            if e not in living or (self.agents is not None and i not in self.agents):
                continue
            for (ahead, left), far in zip(directions(scene, e), distances(scene, i), strict=True):
                x = body.x[e] + far * (body.cosine[e] * ahead - body.sine[e] * left)
                y = body.y[e] + far * (body.sine[e] * ahead + body.cosine[e] * left)
                canvas.segment(body.x[e], body.y[e], x, y, of_side(scene[Side].side[e]), self.width)


def directions(scene: Scene, e: int) -> list[Point]:
    """Return a step along each ray of the agent in row `e`, in metres ahead and to the left, from right to left."""
    lidar = scene.mechanic(systems.Lidar, e)
    bearings = [((k + 0.5) / lidar.rays - 0.5) * lidar.angle for k in range(lidar.rays)]
    return [(math.cos(bearing), math.sin(bearing)) for bearing in bearings]


def distances(scene: Scene, i: int) -> list[float]:
    """Return the readings of the rays of agent number `i`, metres."""
    columns = scene.worlds.layout.fields["lidar"]["distance"].columns
    return scene[LidarView].lidar[i][columns]
