"""Cameras: vision cones, and a line to everybody who is seen. Off unless asked for."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from outlast import systems
from outlast.components import Body, Box, Item, Side, Sight
from outlast.components.sight import OMNISCIENT
from outlast.ecs.simd import SIMD_WIDTH

from ..canvas import Canvas, Point
from ..scene import Scene
from .palette import of_side
from .view import Layer, View

ARC = math.radians(5)  # of a sector's rim, drawn as a straight line


@dataclass(frozen=True)
class Cameras(View):
    """What living agents see, or only those with the numbers `agents`."""

    layer = Layer.SIGHT
    needs = (systems.Cameras, Sight, Side)
    agents: Collection[int] | None = None
    cones: bool = True
    lines: bool = True
    opacity: float = 0.15  # of a cone
    width: float = 0.06  # metres, of a line

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """All cones first, then all lines. Cameras that are not used see nobody."""
        alive = set(scene.living(Body, Side))
        wanted = range(len(scene.rows(Side))) if self.agents is None else self.agents
        watching = [(i, e) for i, e in enumerate(scene.rows(Side)) if e in alive and i in wanted]
        for _, e in watching if self.cones else ():
            canvas.polygon(_cone(scene, e), of_side(scene[Side].side[e]), opacity=self.opacity)
        if scene[Sight].mode[0] == OMNISCIENT or not self.lines:
            return
        body = scene.body
        here = {e for kind in (Side, Box, Item) for e in scene.living(Body, kind)}  # and not walls, which are seen too
        for i, e in watching:
            for o in _seen(scene, i):
                if o in here:
                    color = of_side(scene[Side].side[e])
                    canvas.segment(body.x[e], body.y[e], body.x[o], body.y[o], color, self.width)


def _seen(scene: Scene, i: int) -> Iterator[int]:
    """Rows that agent number `i` sees."""
    for g, word in enumerate(scene[Sight].seen[i]):
        yield from (SIMD_WIDTH * g + j for j in range(SIMD_WIDTH) if word >> j & 1)


def _cone(scene: Scene, e: int) -> list[Point]:
    """Corners of the vision cone: a kite, or a sector whose rim is many short lines."""
    cameras = scene.mechanic(systems.Cameras)
    x, y, angle = scene.body.x[e], scene.body.y[e], math.atan2(scene.body.sine[e], scene.body.cosine[e])
    steps = 2 if cameras.cone == "kite" else 2 * math.ceil(cameras.fov / 2 / ARC)
    bearings = [angle + cameras.fov * (k / steps - 0.5) for k in range(steps + 1)]
    return [(x, y), *((x + cameras.depth * math.cos(a), y + cameras.depth * math.sin(a)) for a in bearings)]
