"""What a view is: the picture of one mechanic."""

from collections.abc import Iterable
from enum import IntEnum
from typing import ClassVar

from outlast.ecs import Component, Module

from ..canvas import Canvas, Image
from ..scene import Scene


class Layer(IntEnum):
    """Lower ones are drawn first; any number between is a layer too."""

    GROUND = 0
    ZONE = 10
    SIGHT = 20
    ITEMS = 30
    BODIES = 40
    STRIKES = 50
    AGENTS = 60
    MARKS = 70
    WORDS = 80


class View:
    """Base of all views. Subclasses say what they need and where they lie, and draw; instances hold options.

    needs: components and mechanics without which there is nothing to draw; where one is missing, the view stays out.
    """

    layer: ClassVar[float] = Layer.BODIES
    needs: ClassVar[tuple[type[Component] | type[Module], ...]] = ()

    def fits(self, scene: Scene) -> bool:
        """Whether this scenario has all that the view needs."""
        return all(need in scene for need in self.needs)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw the world of the scene as it is now."""
        raise NotImplementedError


def paint(canvas: Canvas, views: Iterable[View], scene: Scene) -> Image:
    """Let the views draw, lower layers first, and those of one layer in order of their names. Returns the image."""
    for view in sorted(views, key=lambda view: (view.layer, type(view).__name__)):
        view.draw(canvas, scene)
    return canvas.image
