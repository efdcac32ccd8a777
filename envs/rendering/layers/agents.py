"""Agents: discs in the colour of their side, with a beak ahead."""

from dataclasses import dataclass

from outlast.components import Body, Shape, Side

from ..canvas import Canvas
from ..scene import Scene
from .palette import INK, of_side
from .view import Layer, View

BEAK = ((0.6, 0.75), (1.5, 0), (0.6, -0.75))  # corners, in radii ahead and to the left


@dataclass(frozen=True)
class Agents(View):
    """Living agents."""

    layer = Layer.AGENTS
    needs = (Side,)
    rim: float = 0.08  # metres

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """All of them, the first one lowest."""
        for e in scene.living(Body, Shape, Side):
            self._draw(canvas, scene, e)

    def _draw(self, canvas: Canvas, scene: Scene, e: int) -> None:
        x, y, radius = scene.body.x[e], scene.body.y[e], scene.shape.radius[e]
        cosine, sine = radius * scene.body.cosine[e], radius * scene.body.sine[e]
        canvas.polygon([(x + a * cosine - b * sine, y + a * sine + b * cosine) for a, b in BEAK], INK)
        canvas.circle(x, y, radius, INK)
        canvas.circle(x, y, radius - self.rim, of_side(scene[Side].side[e]))
