"""Strikes of this tick: a bright segment and a star where something was hit, a thin segment where nothing was."""

import math
from dataclasses import dataclass

import numpy as np

from outlast import systems
from outlast.components import Body, Shape, Strike

from ..canvas import Canvas
from ..scene import Scene
from ..style import INK, SIZES, STRIKE, WHITE, Color
from ..visibility import polygon_hits
from .layer import Layer, ZOrder


@dataclass(frozen=True)
class MeleeLayer(Layer):
    """The strikes of the last tick: up to what was hit, or as far as the weapon reaches."""

    zorder = ZOrder.STRIKES
    needs = (Strike, systems.Melee)
    width: float = SIZES.strike

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw strikes from the attacker's place after the tick, as it has moved since it struck."""
        alive = set(scene.living(Body, Shape))
        for strike in scene.events(Strike):
            me, reach = strike.agent, scene.mechanic(systems.Melee, strike.agent).reach
            if me in alive and strike.target >= 0:
                far = _distance(scene, me, strike.target, reach)
                self._draw(canvas, scene, me, far, INK, 2 * self.width)
                self._draw(canvas, scene, me, far, STRIKE, self.width)
            elif me in alive:
                self._draw(canvas, scene, me, reach, INK, self.width / 2)

    def _draw(self, canvas: Canvas, scene: Scene, me: int, far: float, color: Color, width: float) -> None:
        canvas.segment(scene.body.x[me], scene.body.y[me], *_ahead(scene, me, far), color, width)


@dataclass(frozen=True)
class HitsLayer(Layer):
    """A star where a strike of the last tick hit something."""

    zorder = ZOrder.AGENTS + 2
    needs = (Strike, systems.Melee)
    radius: float = SIZES.star
    rim: float = SIZES.star_rim

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw stars on the surface of what was hit, with both at their places after the tick."""
        alive = set(scene.living(Body, Shape))
        for strike in scene.events(Strike):
            if strike.agent in alive and strike.target >= 0:
                reach = scene.mechanic(systems.Melee, strike.agent).reach
                x, y = _ahead(scene, strike.agent, _distance(scene, strike.agent, strike.target, reach))
                for radius, color in ((self.radius + self.rim, INK), (self.radius, STRIKE), (self.radius / 2, WHITE)):
                    _star(canvas, x, y, radius, color)


def _star(canvas: Canvas, x: float, y: float, radius: float, color: Color) -> None:
    """Draw a star: a square, and the same turned by 45 degrees."""
    a = radius * math.sqrt(0.5)
    canvas.polygon([(x + radius, y), (x, y + radius), (x - radius, y), (x, y - radius)], color)
    canvas.polygon([(x + a, y + a), (x - a, y + a), (x - a, y - a), (x + a, y - a)], color)


def _ahead(scene: Scene, me: int, far: float) -> tuple[float, float]:
    body = scene.body
    return body.x[me] + far * body.cosine[me], body.y[me] + far * body.sine[me]


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
