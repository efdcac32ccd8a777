"""Strips for writing: the part of the margin that the game does not reach."""

from ..canvas import Canvas
from ..scene import Scene

MIDDLE, HEIGHT = 0.66, 0.44  # of digits, in margins: bars of agents at the wall reach up to 0.38


def strip(canvas: Canvas, scene: Scene, side: int) -> tuple[float, float] | None:
    """Above (side 1) or below (-1) the room: y of its middle and the height of digits, in metres.

    None where the picture is too small for words.
    """
    margin = scene.half - scene.room
    if not canvas.readable(HEIGHT * margin):
        return None
    return side * (scene.room + MIDDLE * margin), HEIGHT * margin
