"""Hit points: a bar above every agent, and above other bodies that are damaged."""

from dataclasses import dataclass

from outlast.components import Body, Health, Shape, Side
from outlast.components.health import can_hurt

from ..canvas import Canvas
from ..scene import Scene
from ..style import EXTRA, INK, SIZES, of_health
from .layer import Layer, ZOrder

VISIBLE = 0.5  # pixels: height of the lowest bar worth drawing
FRAMED = 1.0  # pixels: height of the lowest bar that gets a frame


@dataclass(frozen=True)
class HealthBarsLayer(Layer):
    """A bar for hit points: full with as many as at the start, and up to twice as long with more."""

    zorder = ZOrder.MARKS
    needs = (Health,)
    length: float = SIZES.bar_length
    height: float = SIZES.bar_height

    def fits(self, scene: Scene) -> bool:
        """Return whether the layer fits: only where something does damage."""
        return super().fits(scene) and can_hurt(scene.worlds.layout)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw bars of all agents, and of other bodies that are damaged; none in very small pictures."""
        if self.height * canvas.scale < VISIBLE:
            return
        points, full, has_health = scene[Health].points, scene.prefab(Health).points, scene[Health].has_health
        agents = set(scene.rows(Side))
        for e in scene.living(Body, Shape, Health):
            if has_health[e] and (e in agents or points[e] < full[e]):
                self._draw(canvas, scene, e, points[e] / max(full[e], 1))

    def _draw(self, canvas: Canvas, scene: Scene, e: int, share: float) -> None:
        height = self.height
        edge = 1 / canvas.scale if height * canvas.scale >= FRAMED else 0
        left = scene.body.x[e] - self.length / 2
        lower = scene.body.y[e] + min(scene.shape.bound[e], SIZES.bar_lift) + SIZES.bar_gap * height
        full, filled = left + self.length, left + self.length * min(max(share, 0), 2)
        canvas.rectangle(left - edge, lower - edge, max(full, filled) + edge, lower + height + edge, INK)
        canvas.rectangle(left, lower, min(full, filled), lower + height, of_health(share))
        if filled > full:
            canvas.rectangle(full, lower, filled, lower + height, EXTRA)
