"""The room: its floor, and what stands around it."""

from dataclasses import dataclass

from outlast.components import Body, Box, Floor, Shape, Side, Solid

from ..canvas import Canvas
from ..scene import Scene
from ..style import FLOOR, WALL
from .layer import Layer, ZOrder


@dataclass(frozen=True)
class RoomLayer(Layer):
    """The floor."""

    zorder = ZOrder.GROUND
    needs = (Floor,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """A rectangle."""
        x, y = scene.sides
        canvas.rectangle(-x, -y, x, y, FLOOR)


@dataclass(frozen=True)
class WallsLayer(Layer):
    """Walls, and all other obstacles that are neither agents nor boxes."""

    zorder = ZOrder.BODIES
    needs = (Solid,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Their shapes, a pixel larger: two walls meet in a single point. Behind them there is nothing to see."""
        others = {*scene.rows(Side), *scene.rows(Box)}
        walls = [e for e in scene.living(Body, Shape, Solid) if e not in others]
        for e in walls:
            canvas.body(scene, e, WALL, 1 / canvas.scale)
        if walls and Floor in scene:
            (x, y), half = scene.sides, scene.half
            for left, lower, right, upper in ((-half, y, half, half), (x, -half, half, half)):
                canvas.rectangle(left, lower, right, upper, WALL)
                canvas.rectangle(-right, -upper, -left, -lower, WALL)
