"""Hit points: a bar above every agent, and above other bodies that are damaged."""

from dataclasses import dataclass

from outlast.components import Body, Health, Shape, Side

from ..canvas import Canvas
from ..scene import Scene
from ..style import EXTRA, INK, SIZES, of_health
from .layer import Layer, ZOrder

VISIBLE = 0.5  # pixels, height of the lowest bar worth drawing
FRAMED = 1.0  # pixels, height of the lowest bar with a frame


@dataclass(frozen=True)
class HealthBarsLayer(Layer):
    """A bar is full at the hit points at the start; more lies over it in another colour."""

    zorder = ZOrder.MARKS
    needs = (Health,)
    length: float = SIZES.bar_length
    height: float = SIZES.bar_height

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Bars of agents, whole or not, and of other bodies if they are not whole; none in very small pictures."""
        if self.height * canvas.scale < VISIBLE:
            return
        points, whole, has_health = scene[Health].points, scene.prefab(Health).points, scene[Health].has_health
        agents = set(scene.rows(Side))
        for e in scene.living(Body, Shape, Health):
            if has_health[e] and (e in agents or points[e] < whole[e]):
                self._draw(canvas, scene, e, points[e] / max(whole[e], 1))

    def _draw(self, canvas: Canvas, scene: Scene, e: int, share: float) -> None:
        height, half = self.height, self.length / 2
        edge = 1 / canvas.scale if height * canvas.scale >= FRAMED else 0
        left = scene.body.x[e] - half
        lower = scene.body.y[e] + min(scene.shape.bound[e], SIZES.bar_lift) + SIZES.bar_gap * height
        canvas.rectangle(left - edge, lower - edge, left + 2 * half + edge, lower + height + edge, INK)
        filled = 2 * half * min(max(share, 0), 1)
        canvas.rectangle(left, lower, left + filled, lower + height, of_health(share))
        if share > 1:
            canvas.rectangle(left, lower, left + 2 * half * min(share - 1, 1), lower + height, EXTRA)
