"""Drawing: the canvas, an RGB picture on which layers draw in metres, and the base of these layers."""

import functools
import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np

from outlast.ecs import Component, Module

from . import opencv as cv2
from .scene import Scene
from .style import EXTRA, Color, of_health

Image = np.ndarray[Any, Any]
Point = tuple[float, float]

SMALLEST, LARGEST = 64, 4096  # pixels: allowed sides of a picture
SHIFT = 4  # bits of a pixel's fraction in OpenCV's fixed-point numbers
UNIT = 1 << SHIFT
FAR = 1000  # in halves of the picture; points farther out would overflow fixed-point numbers
FONT_HEIGHT = 21  # pixels: height of a digit of the font at scale 1
BOLD = 24  # digits of this height, pixels, have strokes a pixel wide, and larger ones in proportion
READABLE = 7  # pixels: height of a digit in the smallest text worth drawing
BLEED = 0.6  # pixels that OpenCV's anti-aliasing adds around a filled shape
THINNEST = 0.5  # pixels: half the width of the thinnest body
ERROR = 0.05  # pixels: distance allowed between a circle and the polygon that is drawn for it


def png(image: Image) -> bytes:
    """Return an RGB picture, uint8 (height, width, 3), as the bytes of a PNG file."""
    done, encoded = cv2.imencode(".png", image[..., ::-1])
    if not done:
        raise ValueError(f"a picture of {image.shape} cannot be a PNG")
    return bytes(encoded)


class Canvas:
    """A picture of the plane around the origin: image is uint8 (height, width, 3), RGB, row 0 on top.

    size: width in pixels, and height as well unless `height` is given. half: distance from the origin to the left and
    right edge, metres. Methods take metres, x to the right and y up, and colours (red, green, blue). Edges are
    anti-aliased, positions are rounded to 1/16 of a pixel, lines are at least one pixel wide. A shape with a coordinate
    that is not a number, or a thousand pictures away, is left out.
    """

    def __init__(self, size: int, half: float, height: int | None = None) -> None:
        self.size, self.half, self.height = size, half, size if height is None else height
        self.image: Image = np.empty((self.height, size, 3), np.uint8)
        self.scale = size / (2 * half)  # pixels per metre
        self._unit, self._far = self.scale * UNIT, FAR * half
        # OpenCV counts from the centre of the first pixel, not from its edge
        self._origin = (size * UNIT / 2 - UNIT / 2, self.height * UNIT / 2 - UNIT / 2)

    def clear(self, color: Color) -> None:
        """Fill the picture with a colour."""
        cv2.rectangle(self.image, (0, 0), (self.size, self.height), color, cv2.FILLED)

    def circle(self, x: float, y: float, radius: float, color: Color, width: float = 0) -> None:
        """Draw a disc, or the outline of one if a width (metres) is given."""
        if self._near(x, y, radius):
            pixels = max(THINNEST, radius * self.scale - (0 if width else BLEED))
            self._draw(_disc(pixels) + np.array(self._at(x, y), np.int32), color, width)

    def segment(self, x: float, y: float, to_x: float, to_y: float, color: Color, width: float) -> None:
        """Draw a straight line."""
        if self._near(x, y, to_x, to_y):
            thick = self._thick(width)
            cv2.line(self.image, self._at(x, y), self._at(to_x, to_y), color, thick, cv2.LINE_AA, SHIFT)

    def polygon(self, corners: Sequence[Point], color: Color, width: float = 0) -> None:
        """Draw a filled convex polygon, or its outline if a width (metres) is given."""
        if sum([abs(x) + abs(y) for x, y in corners]) < self._far:
            self._draw(np.array([self._at(x, y) for x, y in corners], np.int32), color, width)

    def area(self, corners: Image, color: Color, opacity: float) -> None:
        """Draw a filled polygon of any form, blended with the picture below. corners: float (corners, 2)."""
        if not np.abs(corners).sum(1).max() < self._far:
            return
        points = np.rint(corners * (self._unit, -self._unit) + self._origin).astype(np.int32)
        left, top = np.clip(points.min(0) // UNIT - 1, 0, (self.size, self.height)).tolist()
        right, bottom = np.clip(points.max(0) // UNIT + 3, 0, (self.size, self.height)).tolist()
        if left < right and top < bottom:  # only the part around the polygon is touched
            below = self.image[top:bottom, left:right]
            above = below.copy()
            cv2.fillPoly(above, [points - np.array([left * UNIT, top * UNIT], np.int32)], color, cv2.LINE_AA, SHIFT)
            below[:] = cv2.addWeighted(above, opacity, below, 1 - opacity, 0)

    def rectangle(self, left: float, lower: float, right: float, upper: float, color: Color) -> None:
        """Draw a filled upright rectangle with crisp edges: it covers complete pixels, at least one."""
        if self._near(left, lower, right, upper):
            x, y = _whole(self.size / 2 + left * self.scale), _whole(self.height / 2 - upper * self.scale)
            wide, high = _whole((right - left) * self.scale), _whole((upper - lower) * self.scale)
            cv2.rectangle(self.image, (x, y, max(1, wide), max(1, high)), color, cv2.FILLED)

    def body(self, scene: Scene, e: int, color: Color, grow: float = 0) -> None:
        """Draw the shape of entity `e`, `grow` metres larger on all sides."""
        if (radius := scene.shape.radius[e]) > 0:
            self.circle(scene.body.x[e], scene.body.y[e], radius + grow, color)
        else:
            self.polygon(scene.outline(e, grow - BLEED / self.scale, THINNEST / self.scale), color)

    def dashes(self, x: float, y: float, radius: float, color: Color, width: float, dash: float) -> None:
        """Draw a dashed circle; dashes and the gaps between them are `dash` metres long, or a little more."""
        if not self._near(x, y, radius):
            return
        count, thick = max(4, int(math.pi * radius / dash)), self._thick(width)
        ends = np.rint(_rim(2 * count) * (radius * self._unit) + self._at(x, y)).astype(np.int32).tolist()
        for start, end in zip(ends[::2], ends[1::2], strict=True):
            cv2.line(self.image, start, end, color, thick, cv2.LINE_AA, SHIFT)

    def bar(self, left: float, lower: float, upper: float, length: float, share: float) -> None:
        """Draw a bar for hit points, `length` long with as many as at the start, and up to twice as long with more."""
        full, filled = left + length, left + length * min(max(share, 0), 2)
        self.rectangle(left, lower, min(full, filled), upper, of_health(share))
        if filled > full:
            self.rectangle(full, lower, filled, upper, EXTRA)

    def text(self, x: float, y: float, words: str, height: float, color: Color, anchor: float = 0.5) -> None:
        """Write text centred on y, with digits `height` metres high; left out if it would be unreadable.

        anchor: which part of the text is at x: 0 the left end (nearly), 0.5 the middle, 1 the right end.
        """
        if self.readable(height) and self._near(x, y):
            scale, thick = self._font(height)
            left, right, *_ = _ink(words if anchor else "0", scale, thick)
            *_, top, bottom = _ink("0", scale, thick)
            across, down = left + anchor * (right - left), (top + bottom) / 2
            place = round(self.size / 2 + x * self.scale - across), round(self.height / 2 - y * self.scale - down)
            cv2.putText(self.image, words, place, cv2.FONT_HERSHEY_DUPLEX, scale, color, thick, cv2.LINE_AA)

    def length(self, words: str, height: float) -> float:
        """Return the length, in metres, of the words as `text` writes them."""
        left, right, *_ = _ink(words, *self._font(height))
        return (right - left) / self.scale

    def readable(self, height: float) -> bool:
        """Return whether digits `height` metres high are large enough to be read."""
        return height * self.scale >= READABLE

    def _draw(self, points: Image, color: Color, width: float) -> None:
        """Draw a filled convex polygon, or its outline if a width is given."""
        if width:
            cv2.polylines(self.image, [points], True, color, self._thick(width), cv2.LINE_AA, SHIFT)
        else:
            cv2.fillConvexPoly(self.image, points, color, cv2.LINE_AA, SHIFT)

    def _near(self, *lengths: float) -> bool:
        """Return whether these are finite, and small enough for fixed-point numbers."""
        return sum(map(abs, lengths)) < self._far

    def _at(self, x: float, y: float) -> tuple[int, int]:
        return round(self._origin[0] + x * self._unit), round(self._origin[1] - y * self._unit)

    def _font(self, height: float) -> tuple[float, int]:
        pixels = max(1, round(height * self.scale))
        return pixels / FONT_HEIGHT, max(1, round(pixels / BOLD))

    def _thick(self, width: float) -> int:
        return max(1, round(width * self.scale))


def _whole(pixels: float) -> int:
    """Round, halves always up, so that a shape that moves by one pixel does not change its size."""
    return math.floor(pixels + 0.5)


@functools.lru_cache(maxsize=1024)
def _disc(pixels: float) -> Image:
    """Return a polygon that looks like a circle of this radius around 0, in OpenCV's fixed-point numbers."""
    count = 8 * math.ceil(math.pi / math.acos(1 - min(ERROR / pixels, 0.25)) / 8)
    return np.rint(_rim(count) * (pixels * UNIT)).astype(np.int32)


def _rim(count: int) -> Image:
    """Return the corners of a regular polygon on the unit circle, float64 (count, 2)."""
    angles = np.arange(count) * (2 * math.pi / count)
    return np.stack([np.cos(angles), np.sin(angles)], 1)


@functools.lru_cache(maxsize=4096)
def _ink(words: str, scale: float, thick: int) -> tuple[int, int, int, int]:
    """Return left, right, top and bottom of the ink of words by trial, pixels from where OpenCV starts to write."""
    (width, height), below = cv2.getTextSize(words, cv2.FONT_HERSHEY_DUPLEX, scale, thick)
    margin = height + below + 2
    trial = np.zeros((2 * margin + height, 2 * margin + width), np.uint8)
    cv2.putText(trial, words, (margin, margin + height), cv2.FONT_HERSHEY_DUPLEX, scale, (255,), thick, cv2.LINE_AA)
    ys, xs = np.nonzero(trial)
    if not len(xs):
        return 0, 0, 0, 0
    left, top = margin, margin + height
    return int(xs.min()) - left, int(xs.max()) + 1 - left, int(ys.min()) - top, int(ys.max()) + 1 - top


class ZOrder(IntEnum):
    """The order of drawing: layers with lower values are drawn first. Numbers between these are possible, too."""

    GROUND = 0
    ZONE = 10
    SIGHT = 20
    ITEMS = 30
    BODIES = 40
    STRIKES = 50
    AGENTS = 60
    MARKS = 70
    WORDS = 80


class Layer:
    """Base of all layers. Instances hold options.

    Attributes:
        zorder: Layers with a lower value are drawn first.
        needs: Components and mechanics that the layer draws; if the scenario lacks one, the layer is left out.
        shows: Components whose entities the layer draws, so that they are not drawn in the default look as well.
    """

    zorder: ClassVar[float] = ZOrder.BODIES
    needs: ClassVar[tuple[type[Component] | type[Module], ...]] = ()
    shows: ClassVar[tuple[type[Component], ...]] = ()

    def fits(self, scene: Scene) -> bool:
        """Return whether this scenario has everything that the layer needs."""
        return all(need in scene for need in self.needs)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw the world of the scene as it is now."""
        raise NotImplementedError(f"{type(self).__name__} has no method draw(self, canvas, scene): a layer needs one")


class Strip(Layer):
    """Base of layers above or below the picture, as wide as the picture, each on a canvas of its own.

    On that canvas, lengths are in pixels, and the origin is the middle of the strip.

    Attributes:
        above: Whether the strip is above the picture, else below.
    """

    above: ClassVar[bool] = False

    def pixels(self, scene: Scene, size: int) -> int:
        """Return its height for a picture of `size` pixels, the same for all worlds and ticks; 0: left out."""
        raise NotImplementedError(f"{type(self).__name__} has no method pixels(self, scene, size): a strip needs one")
