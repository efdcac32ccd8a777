"""The kill feed, below the room: who died last, and of what."""

from collections.abc import Iterator
from dataclasses import dataclass

from outlast.components import Death, Health, Side, Sides
from outlast.ecs import Clock

from ..canvas import Canvas
from ..scene import Scene
from .palette import PAPER, WALL, mix, of_side
from .strip import strip
from .view import Layer, View


@dataclass(frozen=True)
class KillFeed(View):
    """The last deaths of the episode, the latest on the left, as many as fit; they fade out with age.

    A disc in the colour of who died, its number, and the side that did it, or the cause if nobody did. All of it is
    read from the state: a death keeps its cause and source, and health the tick that brought it to 0.
    """

    layer = Layer.WORDS
    needs = (Death, Health, Side, Sides)
    fresh: int = 90  # ticks in full colour
    fading: int = 60  # ticks from there until it is gone

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """In the margin, which nothing of the game reaches."""
        deaths = list(self._deaths(scene))
        place = strip(canvas, scene, -1) if deaths else None
        if place is None:
            return
        (y, height), x = place, -scene.room
        for age, i, e in deaths:
            words = f"{i} {_fate(scene, e)}"
            end = x + 1.6 * height + canvas.length(words, height)
            if end > scene.room:
                return
            share = max(0, age - self.fresh) / self.fading
            canvas.circle(x + height / 2, y, height / 2, mix(of_side(scene[Side].side[e]), WALL, share))
            canvas.text(x + 1.6 * height, y, words, height, mix(PAPER, WALL, share), anchor=0)
            x = end + 2 * height

    def _deaths(self, scene: Scene) -> Iterator[tuple[int, int, int]]:
        """Age in ticks, agent and row, the youngest first."""
        cause, doomed, tick = scene[Death].cause, scene[Health].doomed, scene[Clock].tick[0]
        alive = set(scene.living(Death))
        dead = [(tick - doomed[e], i, e) for i, e in enumerate(scene.rows(Side)) if e not in alive and cause[e] >= 0]
        yield from (death for death in sorted(dead) if death[0] < self.fresh + self.fading)


def _fate(scene: Scene, e: int) -> str:
    source = scene[Death].source[e]
    if source < 0:
        return f"died of {scene.worlds.layout.causes[scene[Death].cause[e]]}"
    return f"killed by {'side ' if scene[Sides].teams[0] else ''}{source}"
