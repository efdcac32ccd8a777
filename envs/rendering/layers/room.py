"""The room: its floor, and the walls around it."""

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
        """Draw a rectangle."""
        x, y = scene.sides
        canvas.rectangle(-x, -y, x, y, FLOOR)


@dataclass(frozen=True)
class WallsLayer(Layer):
    """Walls, and all other immovable obstacles that are neither agents nor boxes."""

    zorder = ZOrder.BODIES
    needs = (Solid,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw their shapes, a pixel larger, as two walls meet in a single point. Behind them is nothing to see."""
        fixed = walls(scene)
        for e in fixed:
            canvas.body(scene, e, WALL, 1 / canvas.scale)
        if fixed and Floor in scene:
            (x, y), half = scene.sides, scene.half
            for left, lower, right, upper in ((-half, y, half, half), (x, -half, half, half)):
                canvas.rectangle(left, lower, right, upper, WALL)
                canvas.rectangle(-right, -upper, -left, -lower, WALL)


def walls(scene: Scene) -> list[int]:
    """Return the rows of immovable obstacles in the world that are neither agents nor boxes."""
    others, dynamic = {*scene.rows(Side), *scene.rows(Box)}, scene[Solid].dynamic
    return [e for e in scene.living(Body, Shape, Solid) if not dynamic[e] and e not in others]
