"""Cameras: vision cones up to what blocks sight, and a line to every visible entity. Not shown by default."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from outlast import systems
from outlast.components import Body, Filter, Shape, Side, Sight, Solid
from outlast.components.sight import MODES, OMNISCIENT
from outlast.ecs import Clock
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.kernels.simd import SIMD_WIDTH

from ...errors import FilmError
from ..canvas import Canvas, Point
from ..scene import Scene
from ..style import SIZES, of_side
from ..visibility import visible_corners
from .layer import Layer, ZOrder
from .room import walls

ARC = math.radians(5)  # so much of a sector's rim is drawn as a straight line


@dataclass(frozen=True)
class CamerasLayer(Layer):
    """Vision cones of living agents: of all, or of those with the numbers `agents`.

    Raises:
        FilmError: `agents` are not numbers of agents; for agents that a game does not have, when it is drawn.
    """

    zorder = ZOrder.SIGHT
    needs = (systems.Cameras, Sight, Side)
    agents: Collection[int] | None = None
    cones: bool = True
    lines: bool = True
    opacity: float = SIZES.cone_opacity
    width: float = SIZES.sight_line

    def __post_init__(self) -> None:
        numbers: Any = [] if self.agents is None else self.agents
        if not isinstance(numbers, Collection) or not all(is_whole(i, 0) for i in numbers):
            raise FilmError(f"CamerasLayer: agents = {self.agents!r}: numbers of agents are needed, as in [0, 2]")

    def fits(self, scene: Scene) -> bool:
        """Return whether the layer fits: not if observations show everything, as cameras are then not used."""
        return super().fits(scene) and scene.mechanic(systems.Cameras).mode != MODES[OMNISCIENT]

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw all cones, then all lines."""
        alive = set(scene.living(Body, Side))
        wanted = range(len(scene.rows(Side))) if self.agents is None else self.agents
        if unknown := [i for i in wanted if i >= len(scene.rows(Side))]:
            raise FilmError(f"CamerasLayer: no agent {unknown[0]}; they are 0 to {len(scene.rows(Side)) - 1}")
        watching = [(i, e) for i, e in enumerate(scene.rows(Side)) if e in alive and i in wanted]
        if self.cones:
            tick = scene[Clock].tick[0]
            self._draw_cones(canvas, scene, [e for _, e in watching if tick >= blind_until(scene, e)])
        body = scene.body
        for i, e in watching if self.lines else ():
            color = of_side(scene[Side].side[e])
            for o in seen_rows(scene, i):
                canvas.segment(body.x[e], body.y[e], body.x[o], body.y[o], color, self.width)

    def _draw_cones(self, canvas: Canvas, scene: Scene, watching: list[int]) -> None:
        """Draw the vision cones of the agents in these rows, up to the first body that blocks sight."""
        body, radius, cameras = scene.body, scene.shape.radius, scene.mechanic(systems.Cameras)
        kinds = (Body, Shape) if cameras.items_occlude else (Body, Shape, Solid)
        rows = [e for e in scene.living(*kinds) if not is_see_through(scene, e)]
        outlines = {e: scene.outline(e) for e in rows if radius[e] <= 0}
        for e in watching:
            if math.isfinite(body.x[e] + body.y[e] + body.angle[e]):
                own, pose = scene.mechanic(systems.Cameras, e), (body.x[e], body.y[e], body.angle[e])
                discs = [(body.x[o], body.y[o], radius[o]) for o in rows if o != e and radius[o] > 0]
                polygons = [corners for o, corners in outlines.items() if o != e]
                corners = visible_corners(*pose, own.fov, own.depth, own.cone == "kite", discs, polygons)
                canvas.area(corners, of_side(scene[Side].side[e]), self.opacity)


def blind_until(scene: Scene, e: int) -> int:
    """Return the tick before which the agent in row `e` sees nothing; 0: it sees from the first tick on."""
    if systems.Preparation not in scene:
        return 0
    wait = scene.mechanic(systems.Preparation, e)
    return wait.ticks if wait.blind and (not wait.sides or scene[Side].side[e] in wait.sides) else 0


def is_see_through(scene: Scene, e: int) -> bool:
    """Return whether cameras see through the body in this row, of any kind."""
    return Filter in scene and bool(scene[Filter].clear[e])


def cone_corners(cameras: systems.Cameras) -> list[Point]:
    """Return the corners of a vision cone, metres ahead and to the left: a kite, or a sector edged by short lines."""
    steps = 2 if cameras.cone == "kite" else 2 * math.ceil(cameras.fov / 2 / ARC)
    bearings = [cameras.fov * (k / steps - 0.5) for k in range(steps + 1)]
    return [(0.0, 0.0), *((cameras.depth * math.cos(a), cameras.depth * math.sin(a)) for a in bearings)]


def seen_rows(scene: Scene, i: int) -> list[int]:
    """Return the rows that agent number `i` sees, in ascending order; walls are left out, although it sees them."""
    words, fixed = scene[Sight].visible[i], {*walls(scene)} if Solid in scene else {}
    rows = (e for e in scene.living(Body, Shape) if e not in fixed)
    return [e for e in rows if words[e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1]
