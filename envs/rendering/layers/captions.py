"""Captions in the margin: the step counter above the room, and the kill feed below it."""

from collections.abc import Iterator
from dataclasses import dataclass

from outlast.components import Died, Health, Side, Sides
from outlast.ecs import Clock

from ..canvas import Canvas
from ..scene import Scene
from ..style import INK, PAPER, WALL, Color, mix, of_side
from .layer import Layer, Strip, ZOrder
from .title import LINE, digit, printable

# place and height of digits, in margins: bars of agents at a wall reach up to 0.38, and letters reach below digits
MIDDLE, HEIGHT = 0.66, 0.36


@dataclass(frozen=True)
class StepCounterLayer(Layer):
    """The number of steps of the episode, in the upper left corner, if there is room for text."""

    zorder = ZOrder.WORDS

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Write in the margin, which nothing of the game reaches."""
        if (place := margin_line(canvas, scene, 1)) is not None:
            y, height = place
            canvas.text(-scene.room, y, f"tick {scene[Clock].tick[0]}", height, PAPER, anchor=0)


@dataclass(frozen=True)
class KillFeedLayer(Layer):
    """The last deaths of agents that are still dead, the latest on the left, as many as fit; they fade out with age.

    Each is a disc in the colour of the dead agent, its number, and the side that killed it, or else the damage type.
    All of it comes from the state, as events only last for a tick: `Died` keeps damage type and source, `Health` the
    tick in which the points reached 0.
    """

    zorder = ZOrder.WORDS
    needs = (Died, Health, Side, Sides)
    fresh: int = 90  # ticks for which a death is shown in full colour
    fading: int = 60  # ticks in which it fades after that

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Write in the margin, which nothing of the game reaches."""
        if (place := margin_line(canvas, scene, -1)) is not None:
            self.write(canvas, scene, scene.room, *place, WALL)

    def write(self, canvas: Canvas, scene: Scene, half: float, y: float, height: float, ground: Color) -> None:
        """Write a line from x = -half to half on that ground."""
        x = -half
        for age, i, e in self._deaths(scene):
            words = f"{i} {_cause_of_death(scene, e)}"
            end = x + 1.6 * height + canvas.length(words, height)
            if end > half:
                return
            share = max(0, age - self.fresh) / self.fading
            canvas.circle(x + height / 2, y, height / 2, mix(of_side(scene[Side].side[e]), ground, share))
            canvas.text(x + 1.6 * height, y, words, height, mix(PAPER, ground, share), anchor=0)
            x = end + 2 * height

    def _deaths(self, scene: Scene) -> Iterator[tuple[int, int, int]]:
        """Yield the age in ticks, agent and row of each recent death, the newest first."""
        cause, fatal, tick = scene[Died].damage_type, scene[Health].fatal_tick, scene[Clock].tick[0]
        alive = set(scene.living(Died))
        dead = [(tick - fatal[e], i, e) for i, e in enumerate(scene.rows(Side)) if e not in alive and cause[e] >= 0]
        yield from (death for death in sorted(dead) if death[0] < self.fresh + self.fading)


@dataclass(frozen=True)
class FeedStrip(Strip):
    """The last deaths of the episode in a strip below the picture, otherwise like KillFeedLayer in the margin."""

    needs = KillFeedLayer.needs
    zorder = ZOrder.WORDS + 2
    feed: KillFeedLayer = KillFeedLayer()

    def pixels(self, scene: Scene, size: int) -> int:
        """Return the height of one line."""
        return round(LINE * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw as many as fit."""
        height = digit(canvas.size)
        self.feed.write(canvas, scene, canvas.half - height, 0, height, INK)


def _cause_of_death(scene: Scene, e: int) -> str:
    source = scene[Died].source[e]
    if source < 0:
        cause: str = scene.worlds.layout.labels["damage_type"][scene[Died].damage_type[e]]
        return f"died of {cause}"
    return f"killed by {printable(scene.side_name(source)) if scene[Sides].teams[0] else source}"


def margin_line(canvas: Canvas, scene: Scene, side: int) -> tuple[float, float] | None:
    """Return y of a line of text above (side 1) or below (-1) the room, and the height of its digits, in metres.

    None if the picture is too small for text.
    """
    margin = scene.half - scene.room
    if not canvas.readable(HEIGHT * margin):
        return None
    return side * (scene.room + MIDDLE * margin), HEIGHT * margin
