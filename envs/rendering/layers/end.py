"""The end of an episode: who won, and why it ended."""

import math
from dataclasses import dataclass

import numpy as np

from outlast.components import End, Health, Outcome, Score, Side
from outlast.ecs import Clock
from outlast.systems.ending import outliving_wins

from ..canvas import Canvas
from ..scene import Scene
from ..style import INK, PAPER, Color, of_side
from .layer import Layer, ZOrder
from .title import LINE, digit, printable

OPACITY = 0.85
PLACE = 0.55  # y of the banner's middle, in halves of the picture
MOST = 1.9  # width of words at most, in halves of the picture


@dataclass(frozen=True)
class EndLayer(Layer):
    """A banner across the last picture of an episode: the side that won, and why it ended.

    If episodes only end at their limit (ending_rule "never"), survival does not decide who wins: it names no side,
    unless the game has scores of sides (components.Outcome). Pictures too small for its words have no banner.
    """

    zorder = ZOrder.WORDS + 1
    needs = (End,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw it in the upper part, where the fewest episodes end."""
        if not (scene[End].terminated[0] or scene[End].truncated[0]):
            return
        height, wide, y = digit(canvas.size) / canvas.scale, 2 * canvas.half, PLACE * canvas.half
        words, color = _verdict(scene)
        if canvas.length(words, 1.3 * height) + 2.6 * height > MOST * canvas.half:
            return
        upper, lower = y + 1.4 * LINE * height, y - 1.4 * LINE * height
        canvas.area(np.array([(-wide, lower), (wide, lower), (wide, upper), (-wide, upper)]), INK, OPACITY)
        _write(canvas, y + 0.5 * LINE * height, words, 1.3 * height, color)
        _write(canvas, y - 0.6 * LINE * height, _reason(scene), height, None)


def winner(scene: Scene) -> int | None:
    """Return the side that came farther than all others, after the last tick of an episode; or None."""
    if not _rivals(scene):
        return None
    outcomes = scene[Outcome].outcome if Outcome in scene else None
    come = _lived(scene) if outcomes is None else {side: float(outcomes[side]) for side in _sides(scene)}
    best = max(come.values())
    first, *others = (side for side, each in come.items() if each == best)
    return None if others else first


def _lived(scene: Scene) -> dict[int, float]:
    """Return the tick in which each side lost its last member; infinity for sides that live."""
    lived = {side: math.inf if scene[Score].alive[side] else -1.0 for side in _sides(scene)}
    for e in scene.rows(Health, Side) if Health in scene else ():
        if (side := int(scene[Side].side[e])) >= 0:  # absent agents have no side
            lived[side] = max(lived[side], scene[Health].fatal_tick[e])
    return lived


def _sides(scene: Scene) -> set[int]:
    """Return the sides that have agents."""
    return {int(scene[Side].side[e]) for e in scene.rows(Side)} - {-1} if Side in scene else set()


def _verdict(scene: Scene) -> tuple[str, Color | None]:
    """Return the result in words, and the winner's colour; None without a winner."""
    side = winner(scene)
    if side is not None:
        return f"{printable(scene.side_name(side))} wins", of_side(side)
    return "a draw" if _rivals(scene) else "the episode is over", None


def _rivals(scene: Scene) -> bool:
    """Return whether several sides could win, not counting sides without agents."""
    decided = Outcome in scene or (Score in scene and outliving_wins(scene.worlds.layout))
    return decided and len(_sides(scene)) > 1


def _reason(scene: Scene) -> str:
    if scene[End].truncated[0]:
        reason = "time is up"
    else:
        left = sum(count > 0 for count in scene[Score].alive) if Score in scene else 2
        reason = ("all are dead", "the others are dead" if _rivals(scene) else "the end", "the end")[min(left, 2)]
    return f"{reason}, tick {scene[Clock].tick[0]}"


def _write(canvas: Canvas, y: float, words: str, height: float, disc: Color | None) -> None:
    """Write words in the middle, with a disc to the left if it has a colour; nothing if they do not fit."""
    length = canvas.length(words, height) + (0 if disc is None else 2 * height)
    if length > MOST * canvas.half:
        return
    if disc is not None:
        canvas.circle(0.7 * height - length / 2, y, 0.7 * height, disc)
    canvas.text(length / 2, y, words, height, PAPER, anchor=1)
