"""Frames of films: the pictures of some worlds while they run, side by side."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from outlast.ecs import Worlds

from ...errors import FilmError
from ..canvas import LARGEST, SMALLEST, Image
from ..layers import Layer
from ..rgb import draw
from ..style import BLACK

Grid = tuple[int, int]  # rows, columns
WIDEST = 2**14  # pixels, sides of a mosaic: films can do no more
GUTTER = 128  # a world's picture is that many times wider than the lines between pictures


def footage(
    worlds: Worlds,
    ticks: Iterable[object],
    chosen: Sequence[int],
    *,
    size: int = 512,
    layers: Iterable[Layer] | None = None,
    mosaic: Grid | None = None,
    every: int = 1,
) -> Iterator[Image]:
    """Draw some worlds while they run, side by side in each frame.

    Args:
        worlds: All worlds.
        ticks: Each item that is asked for runs the worlds once more; before the first one they were reset.
        chosen: Numbers of the worlds to draw.
        size: Pixels, side of one world's picture.
        layers: See rgb.draw.
        mosaic: Rows and columns of pictures, filled row by row, cells without a world black; None: nearly a square.
        every: The first state is drawn, and after it every `every`-th one.

    Returns:
        Frames, uint8 (height, width, 3), RGB, each a new array, drawn when they are asked for.

    Raises:
        FilmError: For worlds, grids, sizes and numbers that cannot be.
    """
    grid = near_square(len(chosen)) if mosaic is None else mosaic
    _check(worlds, chosen, size, grid, every)
    shown = None if layers is None else list(layers)
    return _frames(worlds, ticks, list(chosen), size, shown, grid, every)


def near_square(count: int) -> Grid:
    """Rows and columns of the smallest grid for `count` pictures that is a square, or has one row less."""
    columns = max(1, math.isqrt(max(0, count - 1)) + 1)
    return max(1, -(-count // columns)), columns


def mosaic_shape(size: int, grid: Grid) -> tuple[int, int]:
    """Height and width in pixels of a mosaic of pictures of this size."""
    gutter = _gutter(size)
    return (size + gutter) * grid[0] - gutter, (size + gutter) * grid[1] - gutter


def _gutter(size: int) -> int:
    return max(1, size // GUTTER)


def _frames(
    worlds: Worlds,
    ticks: Iterable[object],
    chosen: list[int],
    size: int,
    layers: list[Layer] | None,
    grid: Grid,
    every: int,
) -> Iterator[Image]:
    for k, _ in enumerate(ticks):
        if k % every == 0:
            if grid == (1, 1):
                yield draw(worlds, chosen[0], size, layers)
            else:
                yield _tiled([draw(worlds, w, size, layers) for w in chosen], size, grid)


def _tiled(pictures: list[Image], size: int, grid: Grid) -> Image:
    image = np.full((*mosaic_shape(size, grid), 3), BLACK, np.uint8)
    step = size + _gutter(size)
    for k, picture in enumerate(pictures):
        top, left = k // grid[1] * step, k % grid[1] * step
        image[top : top + size, left : left + size] = picture
    return image


def _check(worlds: Worlds, chosen: Sequence[int], size: int, grid: Grid, every: int) -> None:
    if not chosen:
        raise FilmError("no world is chosen: at least one is needed")
    if strange := [w for w in chosen if not 0 <= w < worlds.count]:
        raise FilmError(f"there is no world {strange[0]}: there are {worlds.count}, from 0 on")
    if len(chosen) > grid[0] * grid[1] or min(grid) < 1:
        rows, columns = near_square(len(chosen))
        raise FilmError(
            f"a mosaic of {grid[0]}x{grid[1]} has no room for {len(chosen)} worlds: {rows}x{columns} has, or show fewer"
        )
    if not SMALLEST <= size <= LARGEST:
        raise FilmError(f"size = {size}: {SMALLEST} to {LARGEST} pixels for each world are needed")
    if max(mosaic_shape(size, grid)) > WIDEST:
        raise FilmError(
            f"a mosaic of {grid[0]}x{grid[1]} pictures of {size} pixels is wider than {WIDEST}: take a smaller size"
        )
    if every < 1:
        raise FilmError(f"every = {every}: 1 is every tick, 10 is every tenth")
