"""Frames of films: the pictures of some worlds while they run, side by side."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from outlast.components import End
from outlast.ecs import Clock, Worlds, checked_worlds
from outlast.ecs.kernels.integers import is_whole

from ..errors import FilmError
from .canvas import LARGEST, SMALLEST, Canvas, Image, Layer
from .layers import LAYERS
from .rgb import draw
from .style import BLACK, INK
from .words import LINE, EndLayer, TitleStrip, digit, prefixes, write_ends

Grid = tuple[int, int]  # rows, columns
WIDEST = 2**14  # pixels: the longest side of a mosaic, as of films
GUTTER = 128  # width of a world's picture over that of the lines between pictures


def footage(
    worlds: Worlds,
    ticks: Iterable[object],
    chosen: Sequence[int],
    *,
    size: int = 512,
    layers: Iterable[Layer] | None = None,
    mosaic: Grid | None = None,
    every: int = 1,
    title: str = "",
    hold: int = 0,
) -> Iterator[Image]:
    """Draw some worlds while they run, side by side in each frame.

    Args:
        worlds: All worlds.
        ticks: An iterator whose items each run the worlds for a tick; the first item comes right after a reset.
        chosen: Numbers of the worlds to draw.
        size: Side of one world's picture, pixels.
        layers: See rgb.draw. A TitleStrip adds a title; with an EndLayer, the ends of episodes are held.
        mosaic: Rows and columns of pictures, filled row by row; cells without a world are black. None: nearly a square.
        every: The first state is drawn, and then every `every`-th one.
        title: Text of the title: the game, and the players.
        hold: For how many more frames the end of an episode is shown. A single world stands still. In a
            mosaic the worlds go on, so the end is shown for this many ticks, in at least one frame, and the first ticks
            of that world's next episode are not seen.

    Returns:
        Frames, uint8 (height, width, 3), RGB, each a new array, drawn on demand.

    Raises:
        FilmError: The grid, the size or a number is not valid.
        TypeError: `worlds` is something else, such as an environment.
    """
    grid = near_square(len(chosen)) if mosaic is None else mosaic
    _check(worlds, chosen, size, grid, every)
    shown, single = list(LAYERS if layers is None else layers), grid == (1, 1)
    titled = any(isinstance(layer, TitleStrip) for layer in shown)
    shown = [TitleStrip(title if single else "") if isinstance(layer, TitleStrip) else layer for layer in shown]
    reel = _Reel(worlds, list(chosen), size, shown, hold)
    if single:
        return reel.single(ticks, every)
    return reel.mosaic(ticks, every, grid, title if titled else "")


def near_square(count: int) -> Grid:
    """Return rows and columns of the smallest grid for `count` pictures that is square or has one row less."""
    columns = max(1, math.isqrt(max(0, count - 1)) + 1)
    return max(1, -(-count // columns)), columns


def _gutter(size: int) -> int:
    return max(1, size // GUTTER)


class _Reel:
    """Frames of the chosen worlds; pictures that show the end of an episode are held."""

    def __init__(self, worlds: Worlds, chosen: list[int], size: int, layers: list[Layer], hold: int) -> None:
        self.worlds, self.chosen, self.size, self.layers, self.hold = worlds, chosen, size, layers, hold
        self.marked = any(isinstance(layer, EndLayer) for layer in layers) and End in worlds
        # for worlds at the end of an episode, the clock then
        self.ends: list[tuple[int, ...] | None] = [None] * len(chosen)

    def draw(self, k: int) -> Image:
        """Draw the k-th of the chosen worlds."""
        seed, layers = len(self.seeds()) > 1, self.layers
        layers = [replace(layer, seed=seed) if isinstance(layer, TitleStrip) else layer for layer in layers]
        return draw(self.worlds, self.chosen[k], self.size, layers)

    def seeds(self) -> Image:
        """Return the seeds of the chosen worlds, each once."""
        return np.unique(self.worlds[Clock].seed[self.chosen, 0])

    def just_ended(self) -> list[int]:
        """Return which chosen worlds have ended an episode in the last tick; none if ends are not shown."""
        if not self.marked:
            return []
        end, clock, found = self.worlds[End], self.worlds[Clock], []
        for k, w in enumerate(self.chosen):
            ended = end.terminated[w, 0] or end.truncated[w, 0]
            place = tuple(int(column[w, 0]) for column in clock) if ended else None
            if place is not None and self.ends[k] != place:
                found.append(k)
            self.ends[k] = place
        return found

    def single(self, ticks: Iterable[object], every: int) -> Iterator[Image]:
        """Yield frames of one world, which stands still at the ends of episodes."""
        for k, _ in enumerate(ticks):
            ended = self.just_ended()
            if k % every == 0 or ended:
                frame = self.draw(0)
                yield frame
                for _ in range(self.hold if ended else 0):
                    yield frame.copy()

    def mosaic(self, ticks: Iterable[object], every: int, grid: Grid, title: str) -> Iterator[Image]:
        """Yield frames of several worlds, each of which shows the end of an episode for a while."""
        held, pictures = [0] * len(self.chosen), [np.empty(0, np.uint8)] * len(self.chosen)

        def frame() -> Image:
            for k, left in enumerate(held):
                pictures[k] = pictures[k] if left else self.draw(k)
                held[k] = max(0, left - 1)
            image = _tiled(pictures, grid)
            return np.vstack([_header(image.shape[1], title, self.seeds()), image]) if title else image

        unseen = False
        for tick, _ in enumerate(ticks):
            for k in self.just_ended():
                pictures[k], held[k], unseen = self.draw(k), self.hold // every + 1, True
            if tick % every == 0:
                unseen = False
                yield frame()
        if unseen:  # an episode ended after the last frame
            yield frame()


def _tiled(pictures: list[Image], grid: Grid) -> Image:
    height, width = pictures[0].shape[:2]
    gutter = _gutter(width)
    image = np.full(((height + gutter) * grid[0] - gutter, (width + gutter) * grid[1] - gutter, 3), BLACK, np.uint8)
    for k, picture in enumerate(pictures):
        top, left = k // grid[1] * (height + gutter), k % grid[1] * (width + gutter)
        image[top : top + height, left : left + width] = picture
    return image


def _header(width: int, title: str, seeds: Image) -> Image:
    """Draw the title of a mosaic: with the seed, if all its worlds have the same one."""
    canvas = Canvas(width, width / 2, round(LINE * digit(width)))
    canvas.clear(INK)
    write_ends(canvas, prefixes(title if len(seeds) > 1 else f"{title}, seed {seeds[0]}"), [])
    return canvas.image


def check_pictures(size: int, grid: Grid, every: int) -> None:
    """Raise FilmError unless such pictures are possible, for any worlds. For the arguments see `footage`."""
    given: list[tuple[str, Any]] = [("size", size), ("every", every), *(("mosaic", side) for side in grid)]
    for name, value in given:
        if not is_whole(value):
            raise FilmError(f"{name} = {value!r}: an integer is needed")
    if not SMALLEST <= size <= LARGEST:
        raise FilmError(f"size = {size}: {SMALLEST} to {LARGEST} pixels for each world are needed")
    if (size + _gutter(size)) * max(grid) > WIDEST + _gutter(size):
        raise FilmError(
            f"a mosaic of {grid[0]}x{grid[1]} pictures of {size} pixels is wider than {WIDEST}: take a smaller size"
        )
    if every < 1:
        raise FilmError(f"every = {every}: 1 is every tick, 10 is every tenth")


def _check(worlds: Worlds, chosen: Sequence[int], size: int, grid: Grid, every: int) -> None:
    count = checked_worlds(worlds).count
    if len(chosen) == 0:
        raise FilmError("no world is chosen: at least one is needed")
    check_pictures(size, grid, every)
    if strange := [w for w in chosen if not 0 <= w < count]:
        raise FilmError(f"world {strange[0]} does not exist: there are {count}, from 0 on")
    if len(chosen) > grid[0] * grid[1] or min(grid) < 1:
        rows, columns = near_square(len(chosen))
        raise FilmError(
            f"a mosaic of {grid[0]}x{grid[1]} has no room for {len(chosen)} worlds: {rows}x{columns} has, or show fewer"
        )
