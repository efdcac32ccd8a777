"""Pictures of a world: RGB for people and videos, characters for terminals, and windows that show them."""

import math
from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium.logger import warn

from outlast.components import Bag, Body, Box, BoxItem, Heal, Health, Item, Shape, Side, Wall, Zone
from outlast.components.health import can_hurt
from outlast.ecs import Component, Entity, Worlds, checked_worlds
from outlast.ecs.kernels.integers import is_whole

from ..errors import FilmError, needed
from . import opencv as cv2
from .canvas import LARGEST, SMALLEST, Canvas, Image, Layer, Strip, png
from .layers import LAYERS
from .scene import Scene, kinds
from .style import INK, WALL

RENDER_MODES = ("rgb_array", "ansi")  # of environments
FPS = 30
COLUMNS, LINES = 40, 20  # of the map: characters are about twice as high as wide
BLOCK = "%"
SIGNS: tuple[tuple[type[Component], str], ...] = ((Wall, BLOCK), (Item, "*"), (Heal, "+"), (BoxItem, "="), (Box, "#"))
NUMBERS = "0123456789abcdefghijklmnopqrstuvwxyz"


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


def text(worlds: Worlds, w: int) -> str:
    """Draw world `w` as a map of 40 x 20 characters in a frame, with a line for every agent.

    Agents are 0 to 9, a to z, and then @; # is a box, = a broken box, + a heal, * another item. % is a wall inside the
    room, or the space beside a room that is not square. Colons are outside the safe zone.

    Raises:
        ValueError: The world does not exist.
    """
    scene = _scene(worlds, w)
    across, down = (2 * (np.arange(count) + 0.5) / count - 1 for count in (COLUMNS, LINES))
    middle_x, middle_y = np.meshgrid(scene.room * across, -scene.room * down)  # of characters, metres
    grid = np.full((LINES, COLUMNS), " ")
    if Zone in scene:
        zone_x, zone_y, radius = (getattr(scene[Zone], name)[0] for name in ("x", "y", "radius"))
        grid[(np.hypot(middle_x - zone_x, middle_y - zone_y) > radius) | (radius == 0)] = ":"
    grid[(abs(middle_x) > scene.sides[0]) | (abs(middle_y) > scene.sides[1])] = BLOCK
    for component, sign in SIGNS:
        for e in scene.living(Body, Shape, component):
            for x, y in _points(scene, e):
                _put(grid, scene, x, y, sign)
    alive, agents = set(scene.living(Side)), list[str]()
    for i, e in enumerate(scene.rows(Side)):
        sign = NUMBERS[i] if i < len(NUMBERS) else "@"
        if e in alive:
            _put(grid, scene, scene.body.x[e], scene.body.y[e], sign)
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


def _put(grid: Any, scene: Scene, x: float, y: float, sign: str) -> None:
    """Write a sign at (x, y), unless that is not on the map (or not a number)."""
    across, down = 0.5 + x / (2 * scene.room), 0.5 - y / (2 * scene.room)
    if 0 <= across < 1 and 0 <= down < 1:
        grid[int(LINES * down), int(COLUMNS * across)] = sign


def _points(scene: Scene, e: int) -> Iterator[tuple[float, float]]:
    """Yield the centre of a disc, or points all over a rectangle, dense enough to fill every character it covers."""
    body, shape, gap = scene.body, scene.shape, scene.room / COLUMNS
    x, y, cosine, sine = body.x[e], body.y[e], body.cosine[e], body.sine[e]
    for a in _spread(shape.half_width[e], gap):
        for b in _spread(shape.half_height[e], gap):
            yield x + a * cosine - b * sine, y + a * sine + b * cosine


def _spread(half: float, gap: float) -> list[float]:
    # limited, as a state from somewhere else may have shapes of any size
    count = min(math.ceil(half / gap), 4 * COLUMNS)
    return [half * k / count for k in range(-count, count + 1)] if count else [0.0]


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
