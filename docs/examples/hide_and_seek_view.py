"""How hide and seek looks: locked boxes have the colour of the side that locked them, and lines show who holds what."""

from dataclasses import dataclass

from hide_and_seek import Handled

from outlast.components import Weld
from outlast.drawing import INK, Canvas, Layer, Scene, ZOrder, of_side


@dataclass(frozen=True)
class HandledLayer(Layer):
    """Locked boxes, and a line from each agent to the box that it holds."""

    zorder = ZOrder.STRIKES  # above boxes and below agents
    needs = (Handled, Weld)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """In metres, as everything."""
        body, handled = scene.body, scene[Handled]
        for box in scene.living(Handled):
            if handled.locked_by[box] >= 0:
                canvas.body(scene, box, of_side(handled.locked_by[box]), grow=-0.1)
            if (e := handled.holder[box]) >= 0:
                canvas.segment(body.x[e], body.y[e], body.x[box], body.y[box], INK, width=0.15)
