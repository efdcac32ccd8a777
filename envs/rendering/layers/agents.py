"""Agents: discs in the colour of their side, with a beak ahead and their number."""

import math
from dataclasses import dataclass

from outlast.components import Body, Shape, Side

from ..canvas import READABLE, Canvas
from ..scene import Scene
from ..style import INK, SIZES, ink_on, of_side
from .layer import Layer, ZOrder


@dataclass(frozen=True)
class AgentsLayer(Layer):
    """Living agents."""

    zorder = ZOrder.AGENTS
    needs = (Side,)
    shows = (Side,)
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw all living agents, the first one at the bottom."""
        for e in scene.living(Body, Shape, Side):
            self._draw(canvas, scene, e)

    def _draw(self, canvas: Canvas, scene: Scene, e: int) -> None:
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
        """Draw the numbers in black or white, whichever is easier to read on the disc."""
        alive = set(scene.living(Body, Shape, Side))
        for i, e in enumerate(scene.rows(Side)):
            if e in alive:
                radius, ink = scene.shape.radius[e], ink_on(of_side(scene[Side].side[e]))
                height = max(self.height * radius, READABLE / canvas.scale)
                if math.hypot(height, canvas.length(str(i), height)) < 2 * radius:
                    canvas.text(scene.body.x[e], scene.body.y[e], str(i), height, ink)
