"""The room: its floor, and the walls around it."""

from dataclasses import dataclass

from outlast.components import Body, Box, Filter, Floor, Shape, Side, Solid
from outlast.ecs import Component

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
    """Walls: what has been static from the start, unless it has a look or a layer of its own."""

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


def walls(scene: Scene, living: bool = True) -> list[int]:
    """Return the rows of walls, in the world or, not `living`, all.

    They are solids that were static when the episode began, without agents, boxes, sensors, and what has a look or a
    layer of its own: what is locked later stays what it was.
    """
    shown: set[type[Component]] = {Side, Box, *scene.shown}
    others = {e for part in shown for e in scene.rows(part)} | scene.looks.keys()
    dynamic, sensors = scene.prefab(Solid).dynamic, scene.prefab(Filter).sensor if Filter in scene else None
    rows = scene.living(Body, Shape, Solid) if living else scene.rows(Body, Shape, Solid)
    return [e for e in rows if not (dynamic[e] or e in others or (sensors and sensors[e]))]
