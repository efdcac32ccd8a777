"""Bags: what agents carry, below them."""

from dataclasses import dataclass

from outlast.components import Bag, Body, BoxItem, Heal, Shape

from ..canvas import Canvas
from ..scene import Scene
from .boxes import owner_of
from .palette import BOX, HEAL, INK, of_box
from .view import Layer, View

VISIBLE = 1.0  # pixels, side of the smallest item worth drawing


@dataclass(frozen=True)
class Inventory(View):
    """Carried items in a row below their carrier, the last one, which is the one in use, on the right."""

    layer = Layer.MARKS
    needs = (Bag,)
    half: float = 0.15  # metres, half the side of an item

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Heals are discs, broken boxes are squares, all others are grey discs."""
        if 2 * self.half * canvas.scale < VISIBLE:
            return
        bag, step = scene[Bag], 2.6 * self.half
        for e in scene.living(Body, Shape, Bag):
            count = bag.count[e]
            x, y = scene.body.x[e] - step * (count - 1) / 2, scene.body.y[e] - scene.shape.bound[e] - 2.2 * self.half
            for k in range(count):
                self._draw(canvas, scene, bag.items[e][k], x + k * step, y)

    def _draw(self, canvas: Canvas, scene: Scene, thing: int, x: float, y: float) -> None:
        half, edge = self.half, max(1 / canvas.scale, 0.05)
        if thing in scene.rows(BoxItem):
            outer, color = half + edge, of_box(owner_of(scene, thing))
            canvas.rectangle(x - outer, y - outer, x + outer, y + outer, INK)
            canvas.rectangle(x - half, y - half, x + half, y + half, color)
        else:
            canvas.circle(x, y, half + edge, INK)
            canvas.circle(x, y, half, HEAL if thing in scene.rows(Heal) else BOX)
