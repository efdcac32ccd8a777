"""The title of a film: what is played, and which moment of it the picture shows."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from outlast.ecs import Clock

from ..canvas import Canvas
from ..scene import Scene
from ..style import PAPER
from .layer import Strip, ZOrder

# pixels of a digit's height: at least, at most, and otherwise the strip's length over SHARE
LEAST, MOST, SHARE = 8, 40, 46
LINE = 2.0  # from line to line, in heights of a digit
FIGURE = 0.75  # width of a digit, in its heights


@dataclass(frozen=True)
class TitleStrip(Strip):
    """The game, seed and world; on the right, episode and tick. Parts without room are left out.

    Seed, world and episode are the key of the world's random numbers: an environment with that seed and world plays the
    same episode again. In a world that was reset with a seed of its own, they count from there.

    text: the game and who plays; "" in a mosaic, which has its own title. seed: whether to show the seed in a mosaic,
    too, because worlds have different seeds.
    """

    above = True
    zorder = ZOrder.WORDS
    text: str = ""
    seed: bool = False

    def pixels(self, scene: Scene, size: int) -> int:
        """Return the height of one line."""
        return round(LINE * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw it; the tick has priority, then the game, then the rest."""
        clock = scene[Clock]
        seed, world, episode, tick = (column[0] for column in (clock.seed, clock.world, clock.episode, clock.tick))
        ends = [f"tick {tick}", f"episode {episode}, tick {tick}"]
        starts = prefixes(f"{self.text}, seed {seed}, world {world}")
        if not self.text:
            starts = ["", f"world {world}", *([f"world {world}, seed {seed}"] if self.seed else [])]
        write_ends(canvas, starts, ends)


def write_ends(canvas: Canvas, starts: Iterable[str], ends: Sequence[str]) -> None:
    """Write on a strip the longest of `ends` that fits, on the right, and the longest of `starts`, on the left.

    Ends other than the first take at most half of the strip, and no room that the first start needs. The first start is
    cut if there is not enough room even with the first end. Numbers count as having four digits, so that nothing
    appears or disappears while they grow.
    """
    edge = height = digit(canvas.size)
    first, *longer = map(printable, starts)
    short, *more = ends or [""]
    fitting = [
        words
        for words in more
        if _length(canvas, words) <= _room(canvas) / 2 and canvas.length(first, height) <= _room(canvas, words)
    ]
    right = max(fitting, key=len, default=short if _length(canvas, short) <= _room(canvas) else "")
    room = _room(canvas, right)
    left = max((words for words in longer if _length(canvas, words) <= room), key=len, default=first)
    if canvas.length(left, height) > room:
        left = _cut(canvas, left, room)
    canvas.text(-canvas.half + edge, 0, left, height, PAPER, anchor=0)
    canvas.text(canvas.half - edge, 0, right, height, PAPER, anchor=1)


def _cut(canvas: Canvas, words: str, room: float) -> str:
    """Return the beginning of words and three dots: as much as fits without cutting through a number.

    Numbers are written as in names of scenarios, "ffa_2-melee_damage=25-rewards_alive=1e-05".
    """
    numbers = [found.span() for found in re.finditer(r"(?<==).+?(?=-[A-Za-z_]|,|$)|\d+", words)]
    ends = [end for end in range(len(words) - 1, 0, -1) if not any(low < end < high for low, high in numbers)]
    cuts = (f"{words[:end].rstrip('-, ')}..." for end in ends)
    return next((cut for cut in cuts if canvas.length(cut, digit(canvas.size)) <= room), "")


def fits(words: str, size: int) -> bool:
    """Return whether the words fit on the strip of a film of this size, in pixels, together with the tick."""
    canvas = Canvas(size, size / 2, round(LINE * digit(size)))
    return canvas.length(printable(words), digit(size)) <= _room(canvas, "tick 0")


def _room(canvas: Canvas, right: str = "") -> float:
    """Return the room that is left for words on the left if the words `right` are written on the right."""
    edge = digit(canvas.size)
    return canvas.size - 2 * edge - (_length(canvas, right) + 2 * edge if right else 0)


def _length(canvas: Canvas, words: str) -> float:
    """Return the length of words, with room for a number at their end to grow to four digits."""
    figures = sum(map(str.isdigit, words.rpartition(" ")[2]))
    return canvas.length(words, digit(canvas.size)) + FIGURE * digit(canvas.size) * max(0, 4 - figures)


def prefixes(words: str) -> list[str]:
    """Return the words up to each of their commas, and all of them."""
    parts = words.split(", ")
    return [", ".join(parts[: k + 1]) for k in range(len(parts))]


def printable(words: str) -> str:
    """Return the words with "?" for characters that the fonts of pictures lack."""
    return words.encode("ascii", "replace").decode()


def digit(size: int) -> int:
    """Return the height of a digit on a strip of `size` pixels, pixels."""
    return min(max(LEAST, round(size / SHARE)), MOST)
