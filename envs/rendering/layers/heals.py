"""Heals on the ground: discs with a cross."""

from dataclasses import dataclass

from outlast.components import Body, Heal, Shape

from ..canvas import Canvas
from ..scene import Scene
from ..style import HEAL, SIZES, WHITE
from .layer import Layer, ZOrder

VISIBLE = 6  # pixels: radius of the smallest disc on which a cross is drawn


@dataclass(frozen=True)
class HealsLayer(Layer):
    """Heals on the ground."""

    zorder = ZOrder.ITEMS
    needs = (Heal,)
    shows = (Heal,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw them in their real size."""
        body, radii = scene.body, scene.shape.radius
        for e in scene.living(Body, Shape, Heal):
            x, y, radius = body.x[e], body.y[e], radii[e]
            canvas.circle(x, y, radius, HEAL)
            if radius * canvas.scale >= VISIBLE:
                arm, width = SIZES.cross * radius, SIZES.cross_width * radius
                canvas.segment(x - arm, y, x + arm, y, WHITE, width)
                canvas.segment(x, y - arm, x, y + arm, WHITE, width)
