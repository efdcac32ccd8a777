"""The scoreboard of a film, below the picture: what every agent has left."""

import functools
from dataclasses import dataclass

from outlast.components import Bag, Episode, Health, Kills, Side, Sides
from outlast.components.health import can_hurt
from outlast.ecs import Entity, MemoryLayout

from ..canvas import Canvas
from ..scene import Scene
from ..style import EXTRA, INK, PAPER, WALL, ink_on, mix, of_health, of_side
from .inventory import draw_item
from .layer import Strip, ZOrder
from .title import LINE, digit, printable

DISC, POINTS, BAR, KILLS, RETURN, ITEM, GAP = 1.8, 3.4, 4.0, 4.4, 9.6, 1.3, 0.7  # lengths in heights of a digit
MOST = 6  # maximum items of a bag that are shown
HIGHEST = 0.75  # height of the board at most, as a share of the strip's length; lines beyond that are left out


@dataclass(frozen=True)
class Board:
    """The layout of a scoreboard: agents in columns, in order of their numbers, below a line of teams.

    Attributes:
        parts: What is shown of each agent, with the place where it begins, in heights of a digit.
        width: Width of a column, in heights of a digit.
        rows: How many agents a column has.
        shown: How many agents there is room for.
        lines: Number of lines: of teams, of agents, and one with the number of agents that are left out.
    """

    parts: dict[str, float]
    width: float
    rows: int
    shown: int
    lines: int


@dataclass(frozen=True)
class ScoresStrip(Strip):
    """Agents in the colours of their sides, with hit points, kills and carried items, as far as there is room."""

    needs = (Side,)
    zorder = ZOrder.WORDS + 1

    def pixels(self, scene: Scene, size: int) -> int:
        """Return the height, which does not depend on the agents' sides."""
        return round((_board(scene, size).lines * LINE + GAP) * digit(size))

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw agents below and beside each other, each as a `ScoreLine`."""
        board, unit, alive = _board(scene, canvas.size), digit(canvas.size), {*scene.living(Side)}
        left, top = unit - canvas.half, canvas.height / 2 - 0.5 * (LINE + GAP) * unit
        if _teams(scene):
            _write_teams(canvas, scene, left, top, unit)
        there = [(i, e) for i, e in enumerate(scene.rows(Side)) if scene[Entity].identity[e] >= 0]
        for i, e in there[: board.shown]:
            column, row = divmod(i, board.rows)
            y = top - (row + _teams(scene)) * LINE * unit
            ScoreLine(canvas, scene, board, i, e, e in alive).draw(left + column * board.width * unit, y)
        if (hidden := len(there) - board.shown) > 0:
            y = top - (board.lines - 1) * LINE * unit
            words = f"and {hidden} more"
            words = words if left + canvas.length(words, unit) < canvas.half else f"+{hidden}"
            canvas.text(left, y, words, unit, PAPER, anchor=0)


def _teams(scene: Scene) -> bool:
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


@dataclass(frozen=True)
class ScoreLine:
    """Agent `i` in row `e` on a scoreboard."""

    canvas: Canvas
    scene: Scene
    board: Board
    i: int
    e: int
    alive: bool

    def draw(self, x: float, y: float) -> None:
        """Draw it from x to the right, pixels."""
        unit = digit(self.canvas.size)
        for part, start in self.board.parts.items():
            getattr(self, f"_{part}")(x + start * unit, y, unit)

    def _disc(self, x: float, y: float, unit: int) -> None:
        color = of_side(self.scene[Side].side[self.e])
        color = color if self.alive else mix(color, INK, 0.7)
        self.canvas.circle(x + DISC / 2 * unit, y, DISC / 2 * unit, color)
        height = unit if self.i < 10 else 0.8 * unit
        self.canvas.text(x + DISC / 2 * unit, y, str(self.i), height, ink_on(color) if self.alive else PAPER)

    def _bar(self, x: float, y: float, unit: int) -> None:
        points, start = self.scene[Health].points[self.e], self.scene.prefab(Health).points[self.e]
        # the other half is for hit points beyond those at the start
        share, full = points / max(start, 1), BAR / 2 * unit
        if not self.alive:
            return
        self.canvas.rectangle(x, y - 0.4 * unit, x + full, y + 0.4 * unit, WALL)
        self.canvas.rectangle(x, y - 0.4 * unit, x + full * min(max(share, 0), 1), y + 0.4 * unit, of_health(share))
        if share > 1:
            self.canvas.rectangle(x + full, y - 0.4 * unit, x + full * min(share, 2), y + 0.4 * unit, EXTRA)

    def _points(self, x: float, y: float, unit: int) -> None:
        words = _short(self.scene[Health].points[self.e]) if self.alive else "dead"
        self.canvas.text(x, y, words, unit, PAPER, anchor=0)

    def _kills(self, x: float, y: float, unit: int) -> None:
        self.canvas.text(x, y, _kills(self.scene, self.scene[Side].side[self.e]), unit, PAPER, anchor=0)

    def _return(self, x: float, y: float, unit: int) -> None:
        self.canvas.text(x, y, f"return {_short(self.scene[Episode].returns[self.i])}", unit, PAPER, anchor=0)

    def _bag(self, x: float, y: float, unit: int) -> None:
        bag = self.scene[Bag]
        for k, item in enumerate(bag.items[self.e][: min(bag.count[self.e], MOST)]):
            draw_item(self.canvas, self.scene, item, x + (k + 0.5) * ITEM * unit, y, 0.45 * unit)


def _short(number: float) -> str:
    """Return the number in a few characters: 100, 0.25, 1e+06."""
    return f"{number:.4g}" if abs(number) < 10_000 else f"{number:.0e}"


def _kills(scene: Scene, side: int) -> str:
    kills = scene[Kills].kills[side]
    return f"{kills} kill{'' if kills == 1 else 's'}"


def _board(scene: Scene, size: int) -> Board:
    return _planned(scene.worlds.layout, len(scene.rows(Side)), _teams(scene), size)


@functools.lru_cache(maxsize=64)
def _planned(layout: MemoryLayout, agents: int, teams: bool, size: int) -> Board:
    units = size / digit(size) - 1
    parts, width = _parts(layout, teams, units)
    columns = min(max(1, int(units / width)), agents)
    rows, most = -(-agents // columns), max(1, int(HIGHEST * units / LINE) - teams)
    if rows <= most:
        return Board(parts, units / columns, rows, agents, teams + rows)
    rows = max(1, most - 1)  # a line remains for the number of agents that are left out
    return Board(parts, units / columns, rows, columns * rows, teams + rows + 1)


def _parts(layout: MemoryLayout, teams: bool, units: float) -> tuple[dict[str, float], float]:
    """Return which parts of an agent's entry fit, each with the place where it begins, and the entry's width."""

    def has(component: type) -> bool:
        return component in layout.components

    hurts = has(Health) and can_hurt(layout)
    fights = has(Kills) and can_hurt(layout)
    wanted = [("disc", DISC, True), ("points", POINTS, hurts), ("bar", BAR, hurts)]
    wanted += [("kills", KILLS, fights and not teams), ("return", RETURN, has(Episode) and not fights)]
    wanted += [("bag", min(MOST, layout.dims.get("slots", 0)) * ITEM, has(Bag))]
    parts, at = dict[str, float](), 0.0
    for name, width, there in wanted:
        if there and at + width <= units:
            parts[name], at = at, at + width + GAP
    return parts, at
