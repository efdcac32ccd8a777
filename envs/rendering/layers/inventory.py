"""Bags: what agents carry, below them."""

from dataclasses import dataclass

from outlast.components import Bag, Body, BoxItem, Heal, Shape

from ..canvas import Canvas
from ..scene import Scene
from ..style import HEAL, INK, SIZES, of_box
from .boxes import owner_of
from .layer import Layer, ZOrder
from .others import of_kind

VISIBLE = 1.0  # pixels: side of the smallest item worth drawing


@dataclass(frozen=True)
class InventoryLayer(Layer):
    """Carried items in a row below their carrier, with the last item, which would be used next, on the right."""

    zorder = ZOrder.MARKS
    needs = (Bag,)
    half: float = SIZES.bag_half  # half the side of an item

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw heals as discs, broken boxes as squares, and all others as discs in the colour of their kind."""
        if 2 * self.half * canvas.scale < VISIBLE:
            return
        bag, step = scene[Bag], SIZES.bag_step * self.half
        for e in scene.living(Body, Shape, Bag):
            count = bag.count[e]
            x = scene.body.x[e] - step * (count - 1) / 2
            y = scene.body.y[e] - scene.shape.bound[e] - SIZES.bag_below * self.half
            for k in range(count):
                draw_item(canvas, scene, bag.items[e][k], x + k * step, y, self.half)


def draw_item(canvas: Canvas, scene: Scene, item: int, x: float, y: float, half: float) -> None:
    """Draw the item in row `item` as it looks in a bag, around (x, y), given half of its side."""
    edge = max(1 / canvas.scale, half / 3)
    if item in scene.rows(BoxItem):
        outer, color = half + edge, of_box(owner_of(scene, item))
        canvas.rectangle(x - outer, y - outer, x + outer, y + outer, INK)
        canvas.rectangle(x - half, y - half, x + half, y + half, color)
    else:
        canvas.circle(x, y, half + edge, INK)
        canvas.circle(x, y, half, HEAL if item in scene.rows(Heal) else of_kind(scene, item))
