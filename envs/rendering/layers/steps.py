"""The step counter, above the room."""

from dataclasses import dataclass

from outlast.ecs import Clock

from ..canvas import Canvas
from ..scene import Scene
from .palette import PAPER
from .strip import strip
from .view import Layer, View


@dataclass(frozen=True)
class StepCounter(View):
    """How many steps the episode has had, in the upper left corner, where there is room for text."""

    layer = Layer.WORDS

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """In the margin, which nothing of the game reaches."""
        if (place := strip(canvas, scene, 1)) is not None:
            y, height = place
            canvas.text(-scene.room, y, f"step {scene[Clock].tick[0]}", height, PAPER, anchor=0)
