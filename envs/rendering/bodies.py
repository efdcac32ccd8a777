"""Layers of what is in the room, one for each mechanic: walls, zone, items, boxes, agents, and their marks."""

import math
from dataclasses import dataclass

import numpy as np

from outlast import systems
from outlast.components import Bag, Body, Box, BoxItem, Floor, Guard, Heal, Health, Shape, Side, Solid, Strike, Zone
from outlast.components.health import can_hurt

from .canvas import READABLE, Canvas, Layer, ZOrder
from .scene import Scene, has_size, of_kind, owner_of, unknown, walls
from .sight import polygon_hits
from .style import FLOOR, HEAL, INK, RIM, SIZES, STRIKE, UNSAFE, WALL, WHITE, Color, ink_on, mix, of_box, of_side

POINT = 0.2  # metres: radius with which a body without a size is drawn
# pixels: radius of the smallest heal that has a cross, height of the lowest bar, and side of the smallest carried item
LEAST_HEAL, LEAST_BAR, LEAST_ITEM = 6, 0.5, 1.0
FRAMED = 1.0  # pixels: height of the lowest bar that gets a frame


@dataclass(frozen=True)
class RoomLayer(Layer):
    """The floor."""

    zorder = ZOrder.GROUND
    needs = (Floor,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        x, y = scene.sides
        canvas.rectangle(-x, -y, x, y, FLOOR)


@dataclass(frozen=True)
class WallsLayer(Layer):
    """Walls: what has been static from the start, unless it has a look or a layer of its own."""

    zorder = ZOrder.BODIES
    needs = (Solid,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        fixed = walls(scene)
        for e in fixed:
            canvas.body(scene, e, WALL, 1 / canvas.scale)  # a pixel larger, as two walls meet in a single point
        if fixed and Floor in scene:  # behind them is nothing to see
            (x, y), half = scene.sides, scene.half
            for left, lower, right, upper in ((-half, y, half, half), (x, -half, half, half)):
                canvas.rectangle(left, lower, right, upper, WALL)
                canvas.rectangle(-right, -upper, -left, -lower, WALL)


@dataclass(frozen=True)
class SafeZoneLayer(Layer):
    """The present safe circle and the next one."""

    zorder = ZOrder.ZONE
    needs = (Zone, Floor)
    rim: float = SIZES.zone_rim  # width of the disc's rim, and of dashes
    dash: float = SIZES.zone_dash

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        zone, (half_width, half_height) = scene[Zone], scene.sides
        x, y, radius = zone.x[0], zone.y[0], zone.radius[0]
        canvas.rectangle(-half_width, -half_height, half_width, half_height, UNSAFE)
        if radius <= 0:
            return
        canvas.circle(x, y, radius, RIM)
        canvas.circle(x, y, radius - self.rim, FLOOR)
        x, y, radius, dash = zone.next_x[0], zone.next_y[0], zone.next_radius[0], self.dash
        if radius > 0:
            canvas.dashes(x, y, radius, RIM, self.rim, dash)
        else:  # a cross: the zone is about to vanish
            canvas.segment(x - dash, y - dash, x + dash, y + dash, RIM, self.rim)
            canvas.segment(x - dash, y + dash, x + dash, y - dash, RIM, self.rim)


@dataclass(frozen=True)
class HealsLayer(Layer):
    """Heals on the ground."""

    zorder = ZOrder.ITEMS
    needs = (Heal,)
    shows = (Heal,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for e in scene.living(Body, Shape, Heal):
            x, y, radius = scene.body.x[e], scene.body.y[e], scene.shape.radius[e]
            canvas.circle(x, y, radius, HEAL)
            if radius * canvas.scale >= LEAST_HEAL:
                arm, width = SIZES.cross * radius, SIZES.cross_width * radius
                canvas.segment(x - arm, y, x + arm, y, WHITE, width)
                canvas.segment(x, y - arm, x, y + arm, WHITE, width)


@dataclass(frozen=True)
class BoxesLayer(Layer):
    """Standing boxes."""

    zorder = ZOrder.BODIES
    needs = (Box, Guard)
    shows = (Box,)
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for e in scene.living(Body, Shape, Box):
            _draw_rimmed(canvas, scene, e, of_box(scene[Guard].vulnerable_only_to[e]), 0.5, self.rim)


@dataclass(frozen=True)
class BoxItemsLayer(Layer):
    """Broken boxes on the ground."""

    zorder = ZOrder.ITEMS
    needs = (BoxItem, Box, Guard)
    shows = (BoxItem,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for e in scene.living(Body, Shape, BoxItem):
            color, half = of_box(owner_of(scene, e)), SIZES.box_item * scene.shape.radius[e]
            _draw_square(canvas, scene.body.x[e], scene.body.y[e], half, mix(color, INK, 0.5))
            _draw_square(canvas, scene.body.x[e], scene.body.y[e], half / 2, color)


@dataclass(frozen=True)
class OthersLayer(Layer):
    """Items and bodies that no other layer shows: their shapes in the colour of their kind.

    A layer that draws entities itself names one of their components in `shows`.
    """

    zorder = ZOrder.ITEMS
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for e in unknown(scene):
            _draw_rimmed(canvas, scene, e, of_kind(scene, e), 0.6, self.rim)


@dataclass(frozen=True)
class LooksLayer(Layer):
    """The rings and lines that looks name."""

    zorder = ZOrder.STRIKES
    width: float = 2 * SIZES.sight_line

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        body, living = scene.body, {*scene.living(Body)}
        for e in sorted(scene.looks.keys() & living):
            if scene.looked_up(e, "ring") > 0:
                canvas.circle(body.x[e], body.y[e], scene.shape.bound[e] + 2 * self.width, INK)
                canvas.circle(body.x[e], body.y[e], scene.shape.bound[e] + self.width, FLOOR)
            if (o := int(scene.looked_up(e, "line_to"))) in living:
                canvas.segment(body.x[e], body.y[e], body.x[o], body.y[o], INK, self.width)


def _draw_rimmed(canvas: Canvas, scene: Scene, e: int, color: Color, ink: float, rim: float) -> None:
    """Draw a body with a rim that is darker by the share `ink`, or if it is thin the rim alone, in its look's tint."""
    tint, x, y = scene.looked_up(e, "tint"), scene.body.x[e], scene.body.y[e]
    color = color if tint < 0 else of_box(int(tint))
    if not has_size(scene, e):
        canvas.circle(x, y, POINT, mix(color, INK, ink))
        canvas.circle(x, y, POINT - rim, color)
        return
    canvas.body(scene, e, mix(color, INK, ink))
    if scene.least_half(e) > 2 * rim:
        canvas.body(scene, e, color, -rim)


def _draw_square(canvas: Canvas, x: float, y: float, half: float, color: Color) -> None:
    canvas.rectangle(x - half, y - half, x + half, y + half, color)


@dataclass(frozen=True)
class AgentsLayer(Layer):
    """Living agents."""

    zorder = ZOrder.AGENTS
    needs = (Side,)
    shows = (Side,)
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for e in scene.living(Body, Shape, Side):
            x, y, radius = scene.body.x[e], scene.body.y[e], scene.shape.radius[e]
            cosine, sine = radius * scene.body.cosine[e], radius * scene.body.sine[e]
            canvas.polygon([(x + a * cosine - b * sine, y + a * sine + b * cosine) for a, b in SIZES.beak], INK)
            canvas.circle(x, y, radius, INK)
            canvas.circle(x, y, radius - self.rim, of_side(scene[Side].side[e]))


@dataclass(frozen=True)
class IdsLayer(Layer):
    """The number of every living agent, if it is readable and fits into its disc."""

    zorder = ZOrder.AGENTS + 1
    needs = (Side,)
    height: float = 1.15  # height of a digit, in radii of the agent

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for i, e in scene.agents():
            radius, ink = scene.shape.radius[e], ink_on(of_side(scene[Side].side[e]))
            height = max(self.height * radius, READABLE / canvas.scale)
            if math.hypot(height, canvas.length(str(i), height)) < 2 * radius:
                canvas.text(scene.body.x[e], scene.body.y[e], str(i), height, ink)


@dataclass(frozen=True)
class MeleeLayer(Layer):
    """The strikes of the last tick: up to what was hit, or as far as the weapon reaches."""

    zorder = ZOrder.STRIKES
    needs = (Strike, systems.Melee)
    width: float = SIZES.strike

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for me, x, y, hit in _strikes(scene):
            wide = [(INK, 2 * self.width), (STRIKE, self.width)] if hit else [(INK, self.width / 2)]
            for color, width in wide:
                canvas.segment(scene.body.x[me], scene.body.y[me], x, y, color, width)


@dataclass(frozen=True)
class HitsLayer(Layer):
    """A star where a strike of the last tick hit something."""

    zorder = ZOrder.AGENTS + 2
    needs = (Strike, systems.Melee)
    radius: float = SIZES.star
    rim: float = SIZES.star_rim

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        for x, y in ((x, y) for _, x, y, hit in _strikes(scene) if hit):
            for r, color in ((self.radius + self.rim, INK), (self.radius, STRIKE), (self.radius / 2, WHITE)):
                a = r * math.sqrt(0.5)  # a star is a square, and the same turned by 45 degrees
                canvas.polygon([(x + r, y), (x, y + r), (x - r, y), (x, y - r)], color)
                canvas.polygon([(x + a, y + a), (x - a, y + a), (x - a, y - a), (x + a, y - a)], color)


def _strikes(scene: Scene) -> list[tuple[int, float, float, bool]]:
    """Return the attacker of each strike, if it lives, where the strike ends, and whether it hit: after the tick."""
    body, alive, found = scene.body, set(scene.living(Body, Shape)), []
    for strike in scene.events(Strike):
        if (me := strike.agent) in alive:
            hit, far = strike.target >= 0, scene.mechanic(systems.Melee, me).reach
            far = _distance(scene, me, strike.target, far) if hit else far
            found.append((me, body.x[me] + far * body.cosine[me], body.y[me] + far * body.sine[me], hit))
    return found


def _distance(scene: Scene, me: int, e: int, reach: float) -> float:
    """Return how far ahead of `me` the shape of `e` begins, or if the line ahead misses it, where it passes `e`."""
    body, shape = scene.body, scene.shape
    x, y, cosine, sine = body.x[e] - body.x[me], body.y[e] - body.y[me], body.cosine[me], body.sine[me]
    ahead, aside = x * cosine + y * sine, y * cosine - x * sine
    if shape.radius[e] > 0:
        ahead -= math.sqrt(max(0, shape.radius[e] ** 2 - aside**2))
    else:
        corners = np.array([scene.outline(e)])
        at = float(polygon_hits(np.array([[cosine, sine]]), corners, body.x[me], body.y[me])[0, 0])
        ahead = at if math.isfinite(at) else ahead
    return float(min(max(ahead, 0), reach))


@dataclass(frozen=True)
class HealthBarsLayer(Layer):
    """A bar for hit points: full with as many as at the start, and up to twice as long with more."""

    zorder = ZOrder.MARKS
    needs = (Health,)
    length: float = SIZES.bar_length
    height: float = SIZES.bar_height

    def fits(self, scene: Scene) -> bool:
        return super().fits(scene) and can_hurt(scene.worlds.layout)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        if self.height * canvas.scale < LEAST_BAR:
            return
        points, full, has_health = scene[Health].points, scene.prefab(Health).points, scene[Health].has_health
        edge = 1 / canvas.scale if self.height * canvas.scale >= FRAMED else 0
        for e in scene.living(Body, Shape, Health):
            if has_health[e] and (e in scene.rows(Side) or points[e] < full[e]):  # others only if they are damaged
                share, left = points[e] / max(full[e], 1), scene.body.x[e] - self.length / 2
                right = left + self.length * min(max(share, 1), 2)
                lower = scene.body.y[e] + min(scene.shape.bound[e], SIZES.bar_lift) + SIZES.bar_gap * self.height
                upper = lower + self.height
                canvas.rectangle(left - edge, lower - edge, right + edge, upper + edge, INK)
                canvas.bar(left, lower, upper, self.length, share)


@dataclass(frozen=True)
class InventoryLayer(Layer):
    """Carried items in a row below their carrier, with the last item, which would be used next, on the right."""

    zorder = ZOrder.MARKS
    needs = (Bag,)
    half: float = SIZES.bag_half  # half the side of an item

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        if 2 * self.half * canvas.scale < LEAST_ITEM:
            return
        bag, step = scene[Bag], SIZES.bag_step * self.half
        for e in scene.living(Body, Shape, Bag):
            x = scene.body.x[e] - step * (bag.count[e] - 1) / 2
            y = scene.body.y[e] - scene.shape.bound[e] - SIZES.bag_below * self.half
            for k, item in enumerate(bag.items[e][: bag.count[e]]):
                draw_item(canvas, scene, item, x + k * step, y, self.half)


def draw_item(canvas: Canvas, scene: Scene, item: int, x: float, y: float, half: float) -> None:
    """Draw an item of a bag around (x, y): broken boxes are squares, all others discs in the colour of their kind."""
    edge = max(1 / canvas.scale, half / 3)
    if item in scene.rows(BoxItem):
        _draw_square(canvas, x, y, half + edge, INK)
        _draw_square(canvas, x, y, half, of_box(owner_of(scene, item)))
    else:
        canvas.circle(x, y, half + edge, INK)
        canvas.circle(x, y, half, HEAL if item in scene.rows(Heal) else of_kind(scene, item))
