"""The base of layers: a layer is the picture of one mechanic."""

from collections.abc import Iterable
from enum import IntEnum
from typing import ClassVar

from outlast.ecs import Component, Module

from ...errors import FilmError
from .. import opencv as cv2
from ..canvas import Canvas, Image
from ..scene import Scene
from ..style import INK


class ZOrder(IntEnum):
    """The order of drawing: layers with lower values are drawn first. Numbers between these are possible, too."""

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
        zorder: Layers with a lower value are drawn first.
        needs: Components and mechanics that the layer draws; if the scenario lacks one, the layer is left out.
        shows: Components whose entities the layer draws, so that they are not drawn in the default look as well.
    """

    zorder: ClassVar[float] = ZOrder.BODIES
    needs: ClassVar[tuple[type[Component] | type[Module], ...]] = ()
    shows: ClassVar[tuple[type[Component], ...]] = ()

    def fits(self, scene: Scene) -> bool:
        """Return whether this scenario has everything that the layer needs."""
        return all(need in scene for need in self.needs)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw the world of the scene as it is now."""
        raise NotImplementedError(f"{type(self).__name__} has no method draw(self, canvas, scene): a layer needs one")


class Strip(Layer):
    """Base of layers above or below the picture, as wide as the picture, each on a canvas of its own.

    On that canvas, lengths are in pixels, and the origin is the middle of the strip.

    Attributes:
        above: Whether the strip is above the picture, else below.
    """

    above: ClassVar[bool] = False

    def pixels(self, scene: Scene, size: int) -> int:
        """Return its height for a picture of `size` pixels, the same for all worlds and ticks; 0: left out."""
        raise NotImplementedError(f"{type(self).__name__} has no method pixels(self, scene, size): a strip needs one")


def paint(canvas: Canvas, layers: Iterable[Layer], scene: Scene) -> Image:
    """Draw the layers, those of lower zorder first, equal ones in order of their names. Returns the image."""
    drawn = sorted(layers, key=lambda layer: (layer.zorder, type(layer).__name__))
    scene.shown = {component for layer in drawn for component in layer.shows}
    for layer in drawn:
        _draw(layer, canvas, scene)
    return canvas.image


def paint_strips(size: int, strips: Iterable[Strip], scene: Scene) -> list[Image]:
    """Draw the strips that have a height, each as an image `size` pixels wide."""
    images = []
    for strip in strips:
        if pixels := strip.pixels(scene, size):
            canvas = Canvas(size, size / 2, pixels)
            canvas.clear(INK)
            _draw(strip, canvas, scene)
            images.append(canvas.image)
    return images


def _draw(layer: Layer, canvas: Canvas, scene: Scene) -> None:
    try:
        layer.draw(canvas, scene)
    except cv2.error as error:
        name, text = type(layer).__name__, " ".join(str(error).split()).rpartition("> - ")[2]
        raise FilmError(
            f"{name}.draw: OpenCV cannot draw this; colours are (red, green, blue), each from 0 to 255, all else "
            f"numbers in metres. OpenCV: {text}"
        ) from error
