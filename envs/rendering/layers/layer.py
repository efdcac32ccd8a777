"""What a layer is: the picture of one mechanic."""

from collections.abc import Iterable
from enum import IntEnum
from typing import ClassVar

from outlast.ecs import Component, Module

from ..canvas import Canvas, Image
from ..scene import Scene


class ZOrder(IntEnum):
    """Lower ones are drawn first; any number between is possible, too."""

    GROUND = 0
    ZONE = 10
    SIGHT = 20
    ITEMS = 30
    BODIES = 40
    STRIKES = 50
    AGENTS = 60
    MARKS = 70
    WORDS = 80


class Layer:
    """Base of all layers. Instances hold options.

    Attributes:
        zorder: Layers with a lower one are drawn first.
        needs: Components and mechanics without which there is nothing to draw; without one the layer is left out.
    """

    zorder: ClassVar[float] = ZOrder.BODIES
    needs: ClassVar[tuple[type[Component] | type[Module], ...]] = ()

    def fits(self, scene: Scene) -> bool:
        """Whether this scenario has all that the layer needs."""
        return all(need in scene for need in self.needs)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw the world of the scene as it is now."""
        raise NotImplementedError


def paint(canvas: Canvas, layers: Iterable[Layer], scene: Scene) -> Image:
    """Draw the layers, those with a lower zorder first, equal ones in order of their names. Returns the image."""
    for layer in sorted(layers, key=lambda layer: (layer.zorder, type(layer).__name__)):
        layer.draw(canvas, scene)
    return canvas.image
