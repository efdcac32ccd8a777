"""Cameras: vision cones, and a line to every visible entity. Off unless asked for."""

import math
from collections.abc import Collection
from dataclasses import dataclass

from outlast import systems
from outlast.components import Body, Box, Item, Side, Sight
from outlast.components.sight import OMNISCIENT
from outlast.ecs.simd import SIMD_WIDTH

from ..canvas import Canvas, Point
from ..scene import Scene
from ..style import SIZES, of_side
from .layer import Layer, ZOrder

ARC = math.radians(5)  # of a sector's rim, drawn as a straight line


@dataclass(frozen=True)
class CamerasLayer(Layer):
    """What living agents see, or only those with the numbers `agents`."""

    zorder = ZOrder.SIGHT
    needs = (systems.Cameras, Sight, Side)
    agents: Collection[int] | None = None
    cones: bool = True
    lines: bool = True
    opacity: float = SIZES.cone_opacity
    width: float = SIZES.sight_line

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """All cones first, then all lines. Cameras that are not used see nothing."""
        alive = set(scene.living(Body, Side))
        wanted = range(len(scene.rows(Side))) if self.agents is None else self.agents
        watching = [(i, e) for i, e in enumerate(scene.rows(Side)) if e in alive and i in wanted]
        for _, e in watching if self.cones else ():
            cone = cone_corners(scene.mechanic(systems.Cameras, e))
            canvas.polygon(_placed(scene, e, cone), of_side(scene[Side].side[e]), opacity=self.opacity)
        if scene[Sight].mode[0] == OMNISCIENT or not self.lines:
            return
        body = scene.body
        for i, e in watching:
            color = of_side(scene[Side].side[e])
            for o in seen_rows(scene, i):
                canvas.segment(body.x[e], body.y[e], body.x[o], body.y[o], color, self.width)


def cone_corners(cameras: systems.Cameras) -> list[Point]:
    """Corners of a vision cone, metres ahead and to the left: a kite, or a sector with a rim of short lines."""
    steps = 2 if cameras.cone == "kite" else 2 * math.ceil(cameras.fov / 2 / ARC)
    bearings = [cameras.fov * (k / steps - 0.5) for k in range(steps + 1)]
    return [(0.0, 0.0), *((cameras.depth * math.cos(a), cameras.depth * math.sin(a)) for a in bearings)]


def seen_rows(scene: Scene, i: int) -> list[int]:
    """Rows in the world that agent number `i` sees, in ascending order; without walls, which are seen, too."""
    words = scene[Sight].visible[i]
    rows = sorted({e for kind in (Side, Box, Item) for e in scene.living(Body, kind)})
    return [e for e in rows if words[e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1]


def _placed(scene: Scene, e: int, corners: list[Point]) -> list[Point]:
    body = scene.body
    x, y, cosine, sine = body.x[e], body.y[e], body.cosine[e], body.sine[e]
    return [(x + a * cosine - b * sine, y + a * sine + b * cosine) for a, b in corners]
