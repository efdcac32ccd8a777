"""The room: its floor, and what stands around it."""

from dataclasses import dataclass

from outlast.components import Body, Box, Floor, Shape, Side, Solid

from ..canvas import Canvas
from .palette import FLOOR, WALL
from .scene import Scene
from .view import Layer, View


@dataclass(frozen=True)
class Room(View):
    """The floor."""

    layer = Layer.GROUND
    needs = (Floor,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """A square."""
        half = scene[Floor].size[0] / 2
        canvas.rectangle(-half, -half, half, half, FLOOR)


@dataclass(frozen=True)
class Walls(View):
    """Walls, and all other obstacles that are neither agents nor boxes."""

    layer = Layer.BODIES
    needs = (Solid,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Their shapes, a pixel larger: two walls meet in a single point."""
        others = {*scene.rows(Side), *scene.rows(Box)}
        for e in scene.living(Body, Shape, Solid):
            if e not in others:
                canvas.body(scene, e, WALL, 1 / canvas.scale)
