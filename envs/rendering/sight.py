"""Sight: vision cones up to what blocks them, lines to what is seen, and rays of lidars. Not shown by default.

The outlines of visible floor are the reference for pictures and pages. As in the mechanic `cameras`, a ray ends where
it enters a disc, a rectangle or a convex polygon, a shape that contains the camera hides nothing, and a kite is bounded
by the chords of its arc.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast import systems
from outlast.components import Body, Filter, LidarView, Shape, Side, Sight, Solid
from outlast.components.sight import MODES, OMNISCIENT
from outlast.ecs import Clock
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.kernels.simd import SIMD_WIDTH

from ..errors import FilmError
from .canvas import Canvas, Layer, Point, ZOrder
from .scene import Scene, walls
from .style import SIZES, of_side

Array = np.ndarray[Any, Any]

ARC = math.radians(5)  # so much of a sector's rim is drawn as a straight line
STEP = math.radians(1)  # angle between rays
ASIDE = 1e-5  # radians: rays so far to each side of an edge, one of which meets the body and one passes it
TINY = 1e-12  # metres: replaces a divisor of zero


def visible_corners(
    pose: Sequence[float], cameras: systems.Cameras, discs: Sequence[Sequence[float]], polygons: Sequence[list[Point]]
) -> Array:
    """Return the part of a vision cone that nothing hides: corners of a polygon, float64 (corners, 2), metres.

    The first is the camera's place, from which every point of the polygon can be seen; then comes the far rim,
    counter-clockwise: of a kite, the two chords of the arc's halves. pose: the camera's place, metres, and direction,
    radians. cameras: opening angle, up to pi, reach and form. What blocks sight, except for the camera's own body:
    discs, (x, y, radius), of which those with NaNs hide nothing, and the corners of each rectangle or convex polygon,
    counter-clockwise.
    """
    (x, y, angle), half, depth = pose, cameras.fov / 2, cameras.depth
    most = max(map(len, polygons), default=1)
    round_ = np.array(discs, float).reshape(-1, 3)
    round_ = round_[np.isfinite(round_).all(1)]
    # shorter ones end in equal corners, which bound nothing
    padded = [[*each, *[each[-1]] * (most - len(each))] for each in polygons]
    edged = np.array(padded, float).reshape(-1, most, 2)
    edged = edged[np.isfinite(edged).all((1, 2))]
    middles = edged.mean(1)
    bounds = np.hypot(*(edged - middles[:, None]).transpose(2, 0, 1)).max(1)
    edged = edged[_near(middles, bounds, x, y, angle, half, depth)]
    round_ = round_[_near(round_[:, :2], round_[:, 2], x, y, angle, half, depth)]
    fan = np.linspace(-half, half, 2 * math.ceil(half / STEP) + 1)
    edges = (_edges(round_, edged, x, y) - angle + math.pi) % (2 * math.pi) - math.pi
    bearings = np.unique(np.concatenate([fan, edges[np.abs(edges) < half]]))
    rays = np.stack([np.cos(bearings + angle), np.sin(bearings + angle)], 1)
    rim = np.full(len(bearings), depth)
    if cameras.cone == "kite":
        rim = depth * math.cos(half / 2) / np.cos(np.abs(bearings) - half / 2)
    reach = np.concatenate([rim[:, None], _disc_hits(rays, round_, x, y), polygon_hits(rays, edged, x, y)], 1).min(1)
    return np.concatenate([[(x, y)], (x, y) + reach[:, None] * rays])


def _near(middles: Array, bounds: Array, x: float, y: float, angle: float, half: float, depth: float) -> Array:
    """Return which bodies may reach into the cone, bool (bodies,)."""
    to_x, to_y = middles[:, 0] - x, middles[:, 1] - y
    ahead, aside = math.cos(angle) * to_x + math.sin(angle) * to_y, math.cos(angle) * to_y - math.sin(angle) * to_x
    beside = math.cos(half) * np.abs(aside) - math.sin(half) * ahead  # metres outwards from the nearer edge of the cone
    return (beside <= bounds) & (np.hypot(to_x, to_y) <= depth + bounds)


def _edges(discs: Array, polygons: Array, x: float, y: float) -> Array:
    """Return bearings, in the world's frame, of rays at, just before and just after the edges that the camera sees."""
    middle = np.arctan2(discs[:, 1] - y, discs[:, 0] - x)
    far = np.maximum(np.hypot(discs[:, 0] - x, discs[:, 1] - y), discs[:, 2])
    width = np.arcsin(np.minimum(discs[:, 2] / np.maximum(far, TINY), 1))
    corners = np.arctan2(polygons[..., 1] - y, polygons[..., 0] - x).ravel()
    edges = np.concatenate([middle - width, middle + width, corners])
    return np.concatenate([edges - ASIDE, edges, edges + ASIDE])


def _disc_hits(rays: Array, discs: Array, x: float, y: float) -> Array:
    """Return the metres along each ray to where it enters each disc, float64 (rays, discs)."""
    to_x, to_y = discs[:, 0] - x, discs[:, 1] - y
    along = rays[:, :1] * to_x + rays[:, 1:] * to_y
    inside = along**2 - (to_x**2 + to_y**2 - discs[:, 2] ** 2)  # the square of half the chord along the ray
    enter = along - np.sqrt(np.maximum(inside, 0))
    return np.where((inside >= 0) & (enter >= 0), enter, math.inf)


def polygon_hits(rays: Array, polygons: Array, x: float, y: float) -> Array:
    """Return the metres along each ray from (x, y) to where it enters each convex polygon, float64 (rays, polygons).

    A polygon that contains (x, y) is not entered. rays: directions, (rays, 2), of length 1. polygons: corners,
    counter-clockwise, (polygons, corners, 2), metres.
    """
    along = np.roll(polygons, -1, 1) - polygons
    normals = np.stack([along[..., 1], -along[..., 0]], -1)
    ahead = ((polygons - (x, y)) * normals).sum(-1)  # how far outside each side the origin is, negative
    speed = (rays @ normals.reshape(-1, 2).T).reshape(len(rays), *ahead.shape)
    at = ahead / np.where(speed == 0, TINY, speed)
    enter = np.where(speed < 0, at, -math.inf).max(-1)
    leave = np.where(speed > 0, at, math.inf).min(-1)
    missed = ((speed == 0) & (ahead < 0)).any(-1)
    return np.where((enter > 0) & (enter <= leave) & ~missed, enter, math.inf)


@dataclass(frozen=True)
class _AgentsLayer(Layer):
    """Base of layers of living agents: of all, or of those with the numbers `agents`."""

    zorder = ZOrder.SIGHT
    agents: Collection[int] | None = None

    def __post_init__(self) -> None:
        numbers: Any = [] if self.agents is None else self.agents
        if not isinstance(numbers, Collection) or not all(is_whole(i, 0) for i in numbers):
            name = type(self).__name__
            raise FilmError(f"{name}: agents = {self.agents!r}: numbers of agents are needed, as in [0, 2]")

    def _chosen(self, scene: Scene) -> list[tuple[int, int]]:
        """Return number and row of each agent to draw. Raises FilmError."""
        last = len(scene.rows(Side)) - 1
        if unknown := [i for i in self.agents or () if i > last]:
            raise FilmError(f"{type(self).__name__}: no agent {unknown[0]}; they are 0 to {last}")
        return [(i, e) for i, e in scene.agents() if self.agents is None or i in self.agents]


@dataclass(frozen=True)
class CamerasLayer(_AgentsLayer):
    """Vision cones of living agents: of all, or of those with the numbers `agents`.

    Raises:
        FilmError: `agents` are not numbers of agents; for agents that a game does not have, when it is drawn.
    """

    needs = (systems.Cameras, Sight, Side)
    cones: bool = True
    lines: bool = True
    opacity: float = SIZES.cone_opacity
    width: float = SIZES.sight_line

    def fits(self, scene: Scene) -> bool:  # cameras are not used if observations show everything
        return super().fits(scene) and scene.mechanic(systems.Cameras).mode != MODES[OMNISCIENT]

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        watching = self._chosen(scene)
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
                canvas.area(visible_corners(pose, own, discs, polygons), of_side(scene[Side].side[e]), self.opacity)


@dataclass(frozen=True)
class LidarLayer(_AgentsLayer):
    """The rays of living agents, up to what they hit: of all agents, or of those with the numbers `agents`."""

    needs = (systems.Lidar, LidarView, Side)
    width: float = SIZES.ray

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        body = scene.body
        for i, e in self._chosen(scene):
            for (ahead, left), far in zip(directions(scene, e), distances(scene, i), strict=True):
                x = body.x[e] + far * (body.cosine[e] * ahead - body.sine[e] * left)
                y = body.y[e] + far * (body.sine[e] * ahead + body.cosine[e] * left)
                canvas.segment(body.x[e], body.y[e], x, y, of_side(scene[Side].side[e]), self.width)


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
    words, fixed = scene[Sight].visible[i], {*walls(scene)}
    rows = (e for e in scene.living(Body, Shape) if e not in fixed)
    return [e for e in rows if words[e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1]


def directions(scene: Scene, e: int) -> list[Point]:
    """Return a step along each ray of the agent in row `e`, in metres ahead and to the left, from right to left."""
    lidar = scene.mechanic(systems.Lidar, e)
    bearings = [((k + 0.5) / lidar.rays - 0.5) * lidar.angle for k in range(lidar.rays)]
    return [(math.cos(bearing), math.sin(bearing)) for bearing in bearings]


def distances(scene: Scene, i: int) -> list[float]:
    """Return the readings of the rays of agent number `i`, metres."""
    columns = scene.worlds.layout.fields["lidar"]["distance"].columns
    return scene[LidarView].lidar[i][columns]
