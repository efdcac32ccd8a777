"""Boxes and the items they break into, tinted by the side that owns them."""

from dataclasses import dataclass

from outlast.components import Body, Box, BoxItem, Guard, Shape

from ..canvas import Canvas
from ..scene import Scene
from ..style import INK, SIZES, mix, of_box
from .layer import Layer, ZOrder
from .others import tinted


@dataclass(frozen=True)
class BoxesLayer(Layer):
    """Standing boxes."""

    zorder = ZOrder.BODIES
    needs = (Box, Guard)
    shows = (Box,)
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw their shapes with a rim; very thin ones consist of the rim alone."""
        owner = scene[Guard].vulnerable_only_to
        for e in scene.living(Body, Shape, Box):
            color = tinted(scene, e, of_box(owner[e]))
            canvas.body(scene, e, mix(color, INK, 0.5))
            if scene.least_half(e) > 2 * self.rim:
                canvas.body(scene, e, color, -self.rim)


@dataclass(frozen=True)
class BoxItemsLayer(Layer):
    """Broken boxes on the ground."""

    zorder = ZOrder.ITEMS
    needs = (BoxItem, Box, Guard)
    shows = (BoxItem,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw squares: a dark one in a square of the owner's tint."""
        body, radii = scene.body, scene.shape.radius
        for e in scene.living(Body, Shape, BoxItem):
            color, x, y, half = of_box(owner_of(scene, e)), body.x[e], body.y[e], SIZES.box_item * radii[e]
            canvas.rectangle(x - half, y - half, x + half, y + half, mix(color, INK, 0.5))
            canvas.rectangle(x - half / 2, y - half / 2, x + half / 2, y + half / 2, color)


def owner_of(scene: Scene, item: int) -> int:
    """Return the side that owns the box of which row `item` is the broken form, -1: none."""
    return int(scene[Guard].vulnerable_only_to[scene.rows(Box)[scene[BoxItem].index[item]]])
