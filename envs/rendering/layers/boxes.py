"""Boxes and the items they break into, tinted by the side that owns them."""

from dataclasses import dataclass

from outlast.components import Body, Box, BoxItem, Guard, Shape

from ..canvas import Canvas
from ..scene import Scene
from .palette import INK, mix, of_box
from .view import Layer, View


@dataclass(frozen=True)
class Boxes(View):
    """Boxes that stand."""

    layer = Layer.BODIES
    needs = (Box, Guard)
    rim: float = 0.08  # metres

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Their shapes, with a rim; very thin ones are all rim."""
        owner = scene[Guard].heeds
        for e in scene.living(Body, Shape, Box):
            color = of_box(owner[e])
            canvas.body(scene, e, mix(color, INK, 0.5))
            if min(scene.shape.half_width[e], scene.shape.half_height[e]) > 2 * self.rim:
                canvas.body(scene, e, color, -self.rim)


@dataclass(frozen=True)
class BoxItems(View):
    """Broken boxes that lie around."""

    layer = Layer.ITEMS
    needs = (BoxItem, Box, Guard)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Squares; a dark one in a square of the owner's tint."""
        body, radii = scene.body, scene.shape.radius
        for e in scene.living(Body, Shape, BoxItem):
            color, x, y, half = of_box(owner_of(scene, e)), body.x[e], body.y[e], 0.9 * radii[e]
            canvas.rectangle(x - half, y - half, x + half, y + half, mix(color, INK, 0.5))
            canvas.rectangle(x - half / 2, y - half / 2, x + half / 2, y + half / 2, color)


def owner_of(scene: Scene, thing: int) -> int:
    """The side that owns the box that item `thing` was, -1: nobody."""
    return int(scene[Guard].heeds[scene.rows(Box)[scene[BoxItem].index[thing]]])
