"""Words of pictures and films: title, scoreboard, deaths, the end of an episode, step counter, and legend."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from outlast.components import Bag, Died, End, Episode, Health, Kills, Outcome, Score, Side, Sides
from outlast.components.health import can_hurt
from outlast.ecs import Clock, Entity
from outlast.systems.ending import outliving_wins

from .bodies import draw_item
from .canvas import Canvas, Layer, Strip, ZOrder
from .scene import Scene, kinds, of_kind, unknown
from .style import INK, PAPER, WALL, Color, ink_on, mix, of_side

# pixels of a digit's height on a strip: at least, at most, and otherwise the strip's length over SHARE
LEAST, MOST, SHARE = 8, 40, 46
LINE = 2.0  # from line to line, in heights of a digit
FIGURE = 0.75  # width of a digit, in its heights
# the scoreboard
DISC, POINTS, BAR, KILLS, RETURN, ITEM, GAP = 1.8, 3.4, 4.0, 4.4, 9.6, 1.3, 0.7  # lengths in heights of a digit
ITEMS = 6  # maximum items of a bag that are shown
HIGHEST = 0.75  # height of the board at most, as a share of the strip's length; lines beyond that are left out
# captions, and place and height of digits, in margins: bars at a wall reach up to 0.38, and letters reach below digits
MIDDLE, HEIGHT = 0.66, 0.36
BEFORE, BETWEEN = 1.6, 2.0  # heights of a digit: from the start of a disc to its words, and between entries of a line
COUNTER = "tick 00000 "  # as long as the step counter, which is beside the legend
# the banner at the end
OPACITY = 0.85
PLACE = 0.55  # y of its middle, in halves of the picture: where the fewest episodes end
WIDEST = 1.9  # width of words at most, in halves of the picture


def digit(size: int) -> int:
    """Return the height of a digit on a strip of `size` pixels, pixels."""
    return min(max(LEAST, round(size / SHARE)), MOST)


def printable(words: str) -> str:
    """Return the words with "?" for characters that the fonts of pictures lack."""
    return words.encode("ascii", "replace").decode()


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
        return round(LINE * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        clock = scene[Clock]
        seed, world, episode, tick = (column[0] for column in (clock.seed, clock.world, clock.episode, clock.tick))
        starts = prefixes(f"{self.text}, seed {seed}, world {world}")
        if not self.text:
            starts = ["", f"world {world}", *([f"world {world}, seed {seed}"] if self.seed else [])]
        write_ends(canvas, starts, [f"tick {tick}", f"episode {episode}, tick {tick}"])


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


@dataclass(frozen=True)
class ScoresStrip(Strip):
    """Agents in the colours of their sides, with hit points, kills and carried items, as far as there is room."""

    needs = (Side,)
    zorder = ZOrder.WORDS + 1

    def pixels(self, scene: Scene, size: int) -> int:
        return round((_board(scene, size).lines * LINE + GAP) * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        board, unit, alive = _board(scene, canvas.size), digit(canvas.size), {*scene.living(Side)}
        left, top, teams = unit - canvas.half, canvas.height / 2 - 0.5 * (LINE + GAP) * unit, _has_teams(scene)
        if teams:
            _write_teams(canvas, scene, left, top, unit)
        there = [(i, e) for i, e in enumerate(scene.rows(Side)) if scene[Entity].identity[e] >= 0]
        for i, e in there[: board.shown]:
            column, row = divmod(i, board.rows)
            x, y = left + column * board.width * unit, top - (row + teams) * LINE * unit
            for part, start in board.parts.items():
                _draw_part(canvas, scene, part, i, e, e in alive, x + start * unit, y, unit)
        if (hidden := len(there) - board.shown) > 0:
            words = f"and {hidden} more"
            words = words if left + canvas.length(words, unit) < canvas.half else f"+{hidden}"
            canvas.text(left, top - (board.lines - 1) * LINE * unit, words, unit, PAPER, anchor=0)


def _has_teams(scene: Scene) -> bool:
    """Return whether there is a line of teams, each with the kills of all its agents."""
    return bool(Sides in scene and scene[Sides].teams[0]) and Kills in scene


def _write_teams(canvas: Canvas, scene: Scene, x: float, y: float, unit: int) -> None:
    """Write the kills of all teams, with their names if there is room, or nothing if not even the kills fit."""
    sides = range(len(scene[Kills].kills))
    # the longest number, so that nothing moves when kills grow
    most = "0" * len(str(max(*scene[Kills].kills, len(scene.rows(Side))))) + " kills"
    for names in ([f"{printable(scene.side_name(side))}: " for side in sides], [""] * len(sides)):
        wide = [(DISC + 2) * unit + canvas.length(name + most, unit) for name in names]
        if x + sum(wide) - 2 * unit > canvas.half:
            continue
        for side in sides:
            canvas.circle(x + 0.5 * unit, y, 0.5 * unit, of_side(side))
            canvas.text(x + DISC * unit, y, names[side] + _kills(scene, side), unit, PAPER, anchor=0)
            x += wide[side]
        return


def _draw_part(
    canvas: Canvas, scene: Scene, part: str, i: int, e: int, alive: bool, x: float, y: float, unit: int
) -> None:
    """Draw a part of the entry of agent `i`, in row `e`, from x to the right, pixels."""
    side, words = scene[Side].side[e], ""
    match part:
        case "disc":
            color = of_side(side) if alive else mix(of_side(side), INK, 0.7)
            canvas.circle(x + DISC / 2 * unit, y, DISC / 2 * unit, color)
            height = unit if i < 10 else 0.8 * unit
            canvas.text(x + DISC / 2 * unit, y, str(i), height, ink_on(color) if alive else PAPER)
        case "points":
            words = _short(scene[Health].points[e]) if alive else "dead"
        case "bar" if alive:
            # the other half is for hit points beyond those at the start
            lower, upper, full = y - 0.4 * unit, y + 0.4 * unit, BAR / 2 * unit
            canvas.rectangle(x, lower, x + full, upper, WALL)
            share = scene[Health].points[e] / max(scene.prefab(Health).points[e], 1)
            canvas.bar(x, lower, upper, full, share)
        case "kills":
            words = _kills(scene, side)
        case "return":
            words = f"return {_short(scene[Episode].returns[i])}"
        case "bag":
            for k, item in enumerate(scene[Bag].items[e][: min(scene[Bag].count[e], ITEMS)]):
                draw_item(canvas, scene, item, x + (k + 0.5) * ITEM * unit, y, 0.45 * unit)
    if words:
        canvas.text(x, y, words, unit, PAPER, anchor=0)


def _short(number: float) -> str:
    """Return the number in a few characters: 100, 0.25, 1e+06."""
    return f"{number:.4g}" if abs(number) < 10_000 else f"{number:.0e}"


def _kills(scene: Scene, side: int) -> str:
    kills = scene[Kills].kills[side]
    return f"{kills} kill{'' if kills == 1 else 's'}"


class _Board(NamedTuple):
    """The layout of a scoreboard: agents in columns, in order of their numbers, below a line of teams.

    parts: what is shown of each agent, with the place where it begins. width: of a column; both in heights of a digit.
    rows, shown: of agents, in a column and in all. lines: of teams, of agents, and of how many are left out.
    """

    parts: dict[str, float]
    width: float
    rows: int
    shown: int
    lines: int


def _board(scene: Scene, size: int) -> _Board:
    layout, agents, teams = scene.worlds.layout, len(scene.rows(Side)), _has_teams(scene)
    units, hurts = size / digit(size) - 1, can_hurt(layout)
    fights, lives = Kills in scene and hurts, Health in scene and hurts
    wanted = [("disc", DISC, True), ("points", POINTS, lives), ("bar", BAR, lives)]
    wanted += [("kills", KILLS, fights and not teams), ("return", RETURN, Episode in scene and not fights)]
    wanted += [("bag", min(ITEMS, layout.dims.get("slots", 0)) * ITEM, Bag in scene)]
    parts, end = dict[str, float](), 0.0
    for name, width, needed in wanted:
        if needed and end + width <= units:
            parts[name], end = end, end + width + GAP
    columns = min(max(1, int(units / end)), agents)
    rows, most = -(-agents // columns), max(1, int(HIGHEST * units / LINE) - teams)
    if rows <= most:
        return _Board(parts, units / columns, rows, agents, teams + rows)
    rows = max(1, most - 1)  # a line remains for the number of agents that are left out
    return _Board(parts, units / columns, rows, columns * rows, teams + rows + 1)


def _margin_line(canvas: Canvas, scene: Scene, side: int) -> tuple[float, float] | None:
    """Return y of a line above (side 1) or below (-1) the room, and the height of digits, metres; None if too small."""
    margin = scene.half - scene.room
    if not canvas.readable(HEIGHT * margin):
        return None
    return side * (scene.room + MIDDLE * margin), HEIGHT * margin


@dataclass(frozen=True)
class StepCounterLayer(Layer):
    """The number of steps of the episode, in the upper left corner, if there is room for text."""

    zorder = ZOrder.WORDS

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        if (place := _margin_line(canvas, scene, 1)) is not None:
            y, height = place
            canvas.text(-scene.room, y, f"tick {scene[Clock].tick[0]}", height, PAPER, anchor=0)


@dataclass(frozen=True)
class LegendLayer(Layer):
    """The names of the kinds that OthersLayer draws, above the room, if there is room for text.

    All kinds are named, in the world or not, so that nothing moves, and as many as fit.
    """

    zorder = ZOrder.WORDS

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        names = kinds(scene.worlds.layout)
        named = {names[e]: of_kind(scene, e) for e in unknown(scene, living=False)}
        if not named or (place := _margin_line(canvas, scene, 1)) is None:
            return
        y, height = place
        left, x = canvas.length(COUNTER, height) - scene.room, scene.room + BETWEEN * height
        for name, color in reversed(named.items()):
            words = printable(name.replace("_", " "))
            x -= canvas.length(words, height) + (BETWEEN + BEFORE) * height
            if x < left:
                return
            canvas.circle(x + height / 2, y, height / 2, color)
            canvas.text(x + BEFORE * height, y, words, height, PAPER, anchor=0)


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
        if (place := _margin_line(canvas, scene, -1)) is not None:
            self.write(canvas, scene, scene.room, *place, WALL)

    def write(self, canvas: Canvas, scene: Scene, half: float, y: float, height: float, ground: Color) -> None:
        """Write a line from x = -half to half on that ground, with the newest deaths first."""
        x, cause, alive = -half, scene[Died].damage_type, set(scene.living(Died))
        dead = [(i, e) for i, e in enumerate(scene.rows(Side)) if e not in alive and cause[e] >= 0]
        for age, i, e in sorted((scene[Clock].tick[0] - scene[Health].fatal_tick[e], i, e) for i, e in dead):
            words = f"{i} {_cause_of_death(scene, e)}"
            end = x + BEFORE * height + canvas.length(words, height)
            if end > half or age >= self.fresh + self.fading:
                return
            share = max(0, age - self.fresh) / self.fading
            canvas.circle(x + height / 2, y, height / 2, mix(of_side(scene[Side].side[e]), ground, share))
            canvas.text(x + BEFORE * height, y, words, height, mix(PAPER, ground, share), anchor=0)
            x = end + BETWEEN * height


@dataclass(frozen=True)
class FeedStrip(Strip):
    """The last deaths of the episode in a strip below the picture, otherwise like KillFeedLayer in the margin."""

    needs = KillFeedLayer.needs
    zorder = ZOrder.WORDS + 2
    feed: KillFeedLayer = KillFeedLayer()

    def pixels(self, scene: Scene, size: int) -> int:
        return round(LINE * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        height = digit(canvas.size)
        self.feed.write(canvas, scene, canvas.half - height, 0, height, INK)


def _cause_of_death(scene: Scene, e: int) -> str:
    source = scene[Died].source[e]
    if source < 0:
        return f"died of {scene.worlds.layout.labels['damage_type'][scene[Died].damage_type[e]]}"
    return f"killed by {printable(scene.side_name(source)) if scene[Sides].teams[0] else source}"


@dataclass(frozen=True)
class EndLayer(Layer):
    """A banner across the last picture of an episode: the side that won, and why it ended.

    If episodes only end at their limit (ending_rule "never"), survival does not decide who wins: it names no side,
    unless the game has scores of sides (components.Outcome). Pictures too small for its words have no banner.
    """

    zorder = ZOrder.WORDS + 1
    needs = (End,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        if not (scene[End].terminated[0] or scene[End].truncated[0]):
            return
        height, wide, y = digit(canvas.size) / canvas.scale, 2 * canvas.half, PLACE * canvas.half
        big, words, side = 1.3 * height, "the episode is over", winner(scene)
        if side is not None:
            words = f"{printable(scene.side_name(side))} wins"
        elif _rivals(scene):
            words = "a draw"
        if canvas.length(words, big) + 2 * big > WIDEST * canvas.half:
            return
        upper, lower = y + 1.4 * LINE * height, y - 1.4 * LINE * height
        canvas.area(np.array([(-wide, lower), (wide, lower), (wide, upper), (-wide, upper)]), INK, OPACITY)
        right = canvas.length(words, big) / 2
        if side is not None:
            right += big
            canvas.circle(0.7 * big - right, y + 0.5 * LINE * height, 0.7 * big, of_side(side))
        canvas.text(right, y + 0.5 * LINE * height, words, big, PAPER, anchor=1)
        if (length := canvas.length(reason := _reason(scene), height)) <= WIDEST * canvas.half:
            canvas.text(length / 2, y - 0.6 * LINE * height, reason, height, PAPER, anchor=1)


def winner(scene: Scene) -> int | None:
    """Return the side that came farther than all others, after the last tick of an episode; or None."""
    if not _rivals(scene):
        return None
    if Outcome in scene:
        come = {side: float(scene[Outcome].outcome[side]) for side in _sides(scene)}
    else:  # the tick in which each side lost its last member; infinity for sides that live
        come = {side: math.inf if scene[Score].alive[side] else -1.0 for side in _sides(scene)}
        for e in scene.rows(Health, Side) if Health in scene else ():
            if (side := int(scene[Side].side[e])) >= 0:  # absent agents have no side
                come[side] = max(come[side], scene[Health].fatal_tick[e])
    first, *others = (side for side, each in come.items() if each == max(come.values()))
    return None if others else first


def _sides(scene: Scene) -> set[int]:
    """Return the sides that have agents."""
    return {int(scene[Side].side[e]) for e in scene.rows(Side)} - {-1} if Side in scene else set()


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
