"""Agents: discs in the colour of their side, with a beak ahead and their number."""

from dataclasses import dataclass

from outlast.components import Body, Shape, Side

from ..canvas import Canvas
from .palette import INK, ink_on, of_side
from .scene import Scene
from .view import Layer, View

BEAK = ((0.6, 0.75), (1.5, 0), (0.6, -0.75))  # corners, in radii ahead and to the left


@dataclass(frozen=True)
class Agents(View):
    """Living agents."""

    layer = Layer.AGENTS
    needs = (Side,)
    numbers: bool = True
    rim: float = 0.08  # metres

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """All of them, the first one lowest."""
        alive = set(scene.living(Body, Shape, Side))
        for i, e in enumerate(scene.rows(Side)):
            if e in alive:
                self._draw(canvas, scene, e, str(i))

    def _draw(self, canvas: Canvas, scene: Scene, e: int, number: str) -> None:
        x, y, radius = scene.body.x[e], scene.body.y[e], scene.shape.radius[e]
        cosine, sine = radius * scene.body.cosine[e], radius * scene.body.sine[e]
        color = of_side(scene[Side].side[e])
        canvas.polygon([(x + a * cosine - b * sine, y + a * sine + b * cosine) for a, b in BEAK], INK)
        canvas.circle(x, y, radius, INK)
        canvas.circle(x, y, radius - self.rim, color)
        if self.numbers:
            canvas.text(x, y, number, 1.15 * radius, ink_on(color))
