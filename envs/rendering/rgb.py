"""Pictures of worlds: RGB, side by side in the frames of films, characters for terminals, windows that show them."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.logger import warn

from outlast.components import Bag, Body, Box, BoxItem, End, Heal, Health, Item, Shape, Side, Wall, Zone
from outlast.components.health import can_hurt
from outlast.ecs import Clock, Component, Entity, Worlds, checked_worlds
from outlast.ecs.kernels.integers import is_whole

from ..errors import FilmError, needed
from . import opencv as cv2
from .canvas import LARGEST, SMALLEST, Canvas, Image, Layer, Strip, png
from .layers import LAYERS
from .scene import Scene, kinds
from .style import BLACK, INK, WALL
from .words import LINE, EndLayer, TitleStrip, digit, prefixes, write_ends

RENDER_MODES = ("rgb_array", "ansi")  # of environments
FPS = 30
COLUMNS, ROWS = 40, 20  # of the map: characters are about twice as high as wide
BLOCK = "%"
SIGNS: tuple[tuple[type[Component], str], ...] = ((Wall, BLOCK), (Item, "*"), (Heal, "+"), (BoxItem, "="), (Box, "#"))
NUMBERS = "0123456789abcdefghijklmnopqrstuvwxyz"
Grid = tuple[int, int]  # rows, columns
WIDEST = 2**14  # pixels: the longest side of a mosaic, as of films
GUTTER = 128  # width of a world's picture over that of the lines between pictures


def draw(worlds: Worlds, w: int, size: int = 512, layers: Iterable[Layer] | None = None) -> Image:
    """Draw a world as its tables are now. Before the first reset, these do not show the game yet.

    The same state gives the same bits, and the world is not changed.

    Args:
        worlds: All worlds.
        w: The number of the world to draw.
        size: Side of the picture, 64 to 4096 pixels.
        layers: What to draw (default: LAYERS), in any order; layers that do not fit the scenario are left out.

    Returns:
        The picture, uint8 (size, size, 3), RGB, a new array; higher with layers that are drawn above or below it, such
        as those of FILM_LAYERS.

    Raises:
        ValueError: The size is out of range, or the world does not exist.
        TypeError: A layer is not a Layer, or `worlds` is not an ecs.Worlds.
    """
    _check("size", size, SMALLEST, LARGEST, "pixels")
    scene = _scene(worlds, w)
    fitting = [layer for layer in checked_layers(LAYERS if layers is None else layers) if layer.fits(scene)]
    canvas, size = Canvas(int(size), scene.half), int(size)
    canvas.clear(WALL)
    image = paint(canvas, [layer for layer in fitting if not isinstance(layer, Strip)], scene)
    beside: dict[bool, list[Image]] = {True: [], False: []}  # above and below
    for strip in sorted((layer for layer in fitting if isinstance(layer, Strip)), key=lambda strip: strip.zorder):
        if pixels := strip.pixels(scene, size):
            canvas = Canvas(size, size / 2, pixels)
            canvas.clear(INK)
            beside[strip.above].append(paint(canvas, [strip], scene))
    return np.vstack([*beside[True], image, *beside[False]])


def paint(canvas: Canvas, layers: Iterable[Layer], scene: Scene) -> Image:
    """Draw the layers, those of lower zorder first, equal ones in order of their names. Returns the image."""
    drawn = sorted(layers, key=lambda layer: (layer.zorder, type(layer).__name__))
    scene.shown |= {component for layer in drawn for component in layer.shows}
    for layer in drawn:
        try:
            layer.draw(canvas, scene)
        except cv2.error as error:
            name, found = type(layer).__name__, " ".join(str(error).split()).rpartition("> - ")[2]
            raise FilmError(
                f"{name}.draw: OpenCV cannot draw this; colours are (red, green, blue), each from 0 to 255, all else "
                f"numbers in metres. OpenCV: {found}"
            ) from error
    return canvas.image


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
    _check_footage(worlds, chosen, size, grid, every)
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
        seed = len(self.seeds()) > 1
        layers = [replace(layer, seed=seed) if isinstance(layer, TitleStrip) else layer for layer in self.layers]
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


def _check_footage(worlds: Worlds, chosen: Sequence[int], size: int, grid: Grid, every: int) -> None:
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


def text(worlds: Worlds, w: int) -> str:
    """Draw world `w` as a map of 40 x 20 characters in a frame, with a line for every agent.

    Agents are 0 to 9, a to z, and then @; # is a box, = a broken box, + a heal, * another item. % is a wall inside the
    room, or the space beside a room that is not square. Colons are outside the safe zone.

    Raises:
        ValueError: The world does not exist.
    """
    scene = _scene(worlds, w)
    across, down = (2 * (np.arange(count) + 0.5) / count - 1 for count in (COLUMNS, ROWS))
    middle_x, middle_y = np.meshgrid(scene.room * across, -scene.room * down)  # of characters, metres
    grid = np.full((ROWS, COLUMNS), " ")
    if Zone in scene:
        zone, radius = scene[Zone], scene[Zone].radius[0]
        grid[(np.hypot(middle_x - zone.x[0], middle_y - zone.y[0]) > radius) | (radius == 0)] = ":"
    grid[(abs(middle_x) > scene.sides[0]) | (abs(middle_y) > scene.sides[1])] = BLOCK
    for component, sign in SIGNS:
        for e in scene.living(Body, Shape, component):
            _mark(grid, scene, e, sign, scene.room / COLUMNS)
    alive, agents = set(scene.living(Side)), list[str]()
    for i, e in enumerate(scene.rows(Side)):
        sign = NUMBERS[i] if i < len(NUMBERS) else "@"
        if e in alive:
            _mark(grid, scene, e, sign, math.inf)
        if scene[Entity].identity[e] >= 0:
            agents.append(_about(scene, e, sign, e in alive))
    edge = "+" + "-" * COLUMNS + "+"
    rows = (f"|{''.join(line)}|" for line in grid)
    return "\n".join([edge, *rows, edge, *agents])


def render_world(worlds: Worlds, w: int, render_mode: str) -> Any:
    """Draw world `w` as a picture ("rgb_array", uint8 (512, 512, 3)) or as a map of characters ("ansi", str)."""
    return draw(worlds, w) if render_mode == "rgb_array" else text(worlds, w)


def render_worlds(worlds: Worlds, render_mode: str | None) -> tuple[Any, ...] | None:
    """Draw a frame of each world; None without a mode."""
    if render_mode is None:
        warn(f"render() draws nothing without a render_mode; make the environment with one of {RENDER_MODES}")
        return None
    return tuple(render_world(worlds, w, render_mode) for w in range(worlds.count))


class Pictured:
    """An environment that a notebook's cell shows as a picture of its first world, if the cell ends with it.

    A base class of SurvivalVectorEnv and of the adapters, which have that as `base_env`, TorchRL's as `vector_env`.
    """

    def _repr_png_(self) -> bytes | None:
        """Return world 0 as a PNG of 512 x 512 pixels; None, so that text is shown, if closed or not yet reset."""
        env: Any = getattr(self, "base_env", None) or getattr(self, "vector_env", None) or self
        return None if env.closed or not env._tracker.running[0] else png(draw(env.worlds, 0))


class Window:
    """A window that opens with the first frame and shows at most `fps` frames per second. Needs pygame: ImportError."""

    def __init__(self, fps: int) -> None:
        with needed("window", "a window needs pygame"):
            self.pygame: Any = import_module("pygame")  # imported here, as pygame is optional
        self.fps = fps
        self.clock = self.pygame.time.Clock()
        self.surface: Any = None

    def show(self, frame: np.ndarray[Any, Any]) -> None:
        """Show `frame`, uint8 (height, width, 3)."""
        if self.surface is None:
            self.pygame.display.init()
            self.surface = self.pygame.display.set_mode(frame.shape[1::-1])
            self.pygame.display.set_caption("outlast")
        self.pygame.surfarray.blit_array(self.surface, frame.swapaxes(0, 1))
        self.pygame.event.pump()  # otherwise the system takes the window for dead
        self.pygame.display.flip()
        self.clock.tick(self.fps)

    def close(self) -> None:
        """Close the window. Closing it again does no harm."""
        if self.surface is not None:
            self.pygame.display.quit()
        self.surface = None


def _scene(worlds: Worlds, w: int) -> Scene:
    _check("w", w, 0, checked_worlds(worlds).count - 1, "the number of a world")
    return Scene(worlds, int(w))


def _check(name: str, value: Any, least: int, most: int, unit: str) -> None:
    if not is_whole(value, least, most):
        raise ValueError(f"{name} = {value!r}: an integer from {least} to {most} is needed ({unit})")


def checked_layers(layers: Any) -> list[Layer]:
    """Return the layers as a list. Raises TypeError for anything that is not a layer."""
    if not isinstance(layers, Iterable):
        example = type(layers).__name__ if isinstance(layers, Layer) else "CamerasLayer"
        raise TypeError(f"layers = {layers!r:.60}: a list is needed, as in layers=[{example}()]")
    found = list(layers)
    for layer in found:
        if not isinstance(layer, Layer):
            raise TypeError(f"{layer!r} is not a layer: pass instances, as in layers=[*LAYERS, CamerasLayer()]")
        if not isinstance(layer.needs, tuple):
            raise TypeError(f"{type(layer).__name__}.needs = {layer.needs!r:.60}: a tuple is needed, as in (Body,)")
    return found


def _mark(grid: Any, scene: Scene, e: int, sign: str, gap: float) -> None:
    """Write a sign at the centre of a body, and if `gap` is finite in every character that a rectangle covers.

    What is not on the map (or not a number) is left out. gap: metres from point to point of the rectangle, at most.
    """
    body, sides = scene.body, []
    for half in (scene.shape.half_width[e], scene.shape.half_height[e]):
        # limited, as a state from somewhere else may have shapes of any size
        count = min(math.ceil(half / gap), 4 * COLUMNS)
        sides.append(half * np.arange(-count, count + 1) / max(1, count))
    a, b = np.meshgrid(*sides)
    across = 0.5 + (body.x[e] + a * body.cosine[e] - b * body.sine[e]) / (2 * scene.room)
    down = 0.5 - (body.y[e] + a * body.sine[e] + b * body.cosine[e]) / (2 * scene.room)
    there = (across >= 0) & (across < 1) & (down >= 0) & (down < 1)
    grid[(ROWS * down[there]).astype(int), (COLUMNS * across[there]).astype(int)] = sign


def _about(scene: Scene, e: int, sign: str, alive: bool) -> str:
    """Return the line of an agent: sign, side, hit points, what it carries."""
    words = [f"{sign} side {scene[Side].side[e]}"]
    if not alive:
        words.append("dead")
    elif Health in scene and can_hurt(scene.worlds.layout):
        words.append(f"health {scene[Health].points[e]}")
    if alive and Bag in scene:
        words += [kinds(scene.worlds.layout)[item] for item in scene[Bag].items[e] if item >= 0]
    return " ".join(words)
