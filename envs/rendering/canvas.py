"""The canvas: an RGB picture that layers draw on, in metres."""

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import opencv as cv2
from .scene import Scene
from .style import Color

Image = np.ndarray[Any, Any]
Point = tuple[float, float]
Projection = tuple[float, float, float, float]  # to fixed-point numbers: units per metre, the origin, metres to FAR

SMALLEST, LARGEST = 64, 4096  # pixels: allowed sides of a picture
SHIFT = 4  # bits of a pixel's fraction in OpenCV's fixed-point numbers
UNIT = 1 << SHIFT
FAR = 1000  # in halves of the picture; points farther out would overflow fixed-point numbers
FONT_HEIGHT = 21  # pixels: height of a digit of the font at scale 1
BOLD = 24  # digits of this height, pixels, have strokes a pixel wide, and larger ones in proportion
READABLE = 7  # pixels: height of a digit in the smallest text worth drawing
BLEED = 0.6  # pixels that OpenCV's anti-aliasing adds around a filled shape
THINNEST = 0.5  # pixels: half the width of the thinnest body
KEPT = 2**14  # how many shapes' corners are cached
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
        self._unit = self.scale * UNIT
        # OpenCV counts from the centre of the first pixel, not from its edge
        middle, down = (side * UNIT / 2 - UNIT / 2 for side in (size, self.height))
        self._origin, self._far = (middle, down), FAR * half
        self._projection = self._unit, middle, down, self._far

    def clear(self, color: Color) -> None:
        """Fill the picture with a colour."""
        cv2.rectangle(self.image, (0, 0), (self.size, self.height), color, cv2.FILLED)

    def circle(self, x: float, y: float, radius: float, color: Color, width: float = 0) -> None:
        """Draw a disc, or the outline of one if a width (metres) is given."""
        if not abs(x) + abs(y) + abs(radius) < self._far:
            return
        pixels = max(THINNEST, radius * self.scale - (0 if width else BLEED))
        self._draw(_disc_at(pixels, *self._at(x, y)), color, width)

    def segment(self, x: float, y: float, to_x: float, to_y: float, color: Color, width: float) -> None:
        """Draw a straight line."""
        if abs(x) + abs(y) + abs(to_x) + abs(to_y) < self._far:
            thick = self._thick(width)
            cv2.line(self.image, self._at(x, y), self._at(to_x, to_y), color, thick, cv2.LINE_AA, SHIFT)

    def polygon(self, corners: Sequence[Point], color: Color, width: float = 0) -> None:
        """Draw a filled convex polygon, or its outline if a width (metres) is given."""
        self._draw(_fixed(corners, self._projection), color, width)

    def area(self, corners: Image, color: Color, opacity: float) -> None:
        """Draw a filled polygon of any form, blended with the picture below. corners: float (corners, 2)."""
        if not np.abs(corners).sum(1).max() < self._far:
            return
        self._glaze(np.rint(corners * (self._unit, -self._unit) + self._origin).astype(np.int32), color, opacity)

    def rectangle(self, left: float, lower: float, right: float, upper: float, color: Color) -> None:
        """Draw a filled upright rectangle with crisp edges: it covers complete pixels, at least one."""
        if abs(left) + abs(lower) + abs(right) + abs(upper) < self._far:
            x, y = _whole(self.size / 2 + left * self.scale), _whole(self.height / 2 - upper * self.scale)
            wide, high = _whole((right - left) * self.scale), _whole((upper - lower) * self.scale)
            cv2.rectangle(self.image, (x, y, max(1, wide), max(1, high)), color, cv2.FILLED)

    def body(self, scene: Scene, e: int, color: Color, grow: float = 0) -> None:
        """Draw the shape of entity `e`, `grow` metres larger on all sides."""
        body, shape = scene.body, scene.shape
        if shape.radius[e] > 0:
            self.circle(body.x[e], body.y[e], shape.radius[e] + grow, color)
            return
        grow -= BLEED / self.scale
        if corners := scene.placed_corners(e, grow):
            self.polygon(corners, color)
            return
        thinnest = THINNEST / self.scale
        a, b = max(thinnest, shape.half_width[e] + grow), max(thinnest, shape.half_height[e] + grow)
        self._draw(_turned(body.x[e], body.y[e], body.cosine[e], body.sine[e], a, b, self._projection), color)

    def dashes(self, x: float, y: float, radius: float, color: Color, width: float, dash: float) -> None:
        """Draw a dashed circle; dashes and the gaps between them are `dash` metres long, or a little more."""
        if not abs(x) + abs(y) + abs(radius) < self._far:
            return
        count, thick = max(4, int(math.pi * radius / dash)), self._thick(width)
        ends = np.rint(_rim(2 * count) * (radius * self._unit) + self._at(x, y)).astype(np.int32).tolist()
        for start, end in zip(ends[::2], ends[1::2], strict=True):
            cv2.line(self.image, start, end, color, thick, cv2.LINE_AA, SHIFT)

    def text(self, x: float, y: float, words: str, height: float, color: Color, anchor: float = 0.5) -> None:
        """Write text centred on y, with digits `height` metres high; left out if it would be unreadable.

        anchor: which part of the text is at x: 0 the left end (nearly), 0.5 the middle, 1 the right end.
        """
        if self.readable(height) and abs(x) + abs(y) < self._far:
            scale, thick = self._font(height)
            left, right, middle = _ink(words if anchor else "0", scale, thick)
            across = left + anchor * (right - left)
            place = round(self.size / 2 + x * self.scale - across), round(self.height / 2 - y * self.scale - middle)
            cv2.putText(self.image, words, place, cv2.FONT_HERSHEY_DUPLEX, scale, color, thick, cv2.LINE_AA)

    def length(self, words: str, height: float) -> float:
        """Return the length, in metres, of the words as `text` writes them."""
        left, right, _ = _ink(words, *self._font(height))
        return (right - left) / self.scale

    def readable(self, height: float) -> bool:
        """Return whether digits `height` metres high are large enough to be read."""
        return height * self.scale >= READABLE

    def _draw(self, points: Image | None, color: Color, width: float = 0) -> None:
        """Draw a filled convex polygon, or its outline if a width is given; nothing without points."""
        if points is not None and width:
            cv2.polylines(self.image, [points], True, color, self._thick(width), cv2.LINE_AA, SHIFT)
        elif points is not None:
            cv2.fillConvexPoly(self.image, points, color, cv2.LINE_AA, SHIFT)

    def _font(self, height: float) -> tuple[float, int]:
        pixels = max(1, round(height * self.scale))
        return pixels / FONT_HEIGHT, max(1, round(pixels / BOLD))

    def _glaze(self, points: Image, color: Color, opacity: float) -> None:
        """Blend a polygon into the picture; only the part around the polygon is touched."""
        left, top = np.clip(points.min(0) // UNIT - 1, 0, (self.size, self.height)).tolist()
        right, bottom = np.clip(points.max(0) // UNIT + 3, 0, (self.size, self.height)).tolist()
        if left < right and top < bottom:
            below = self.image[top:bottom, left:right]
            above = below.copy()
            moved = points - np.array([left * UNIT, top * UNIT], np.int32)
            cv2.fillPoly(above, [moved], color, cv2.LINE_AA, SHIFT)
            below[:] = cv2.addWeighted(above, opacity, below, 1 - opacity, 0)

    def _at(self, x: float, y: float) -> tuple[int, int]:
        return round(self._origin[0] + x * self._unit), round(self._origin[1] - y * self._unit)

    def _thick(self, width: float) -> int:
        return max(1, round(width * self.scale)) if width else cv2.FILLED


@functools.lru_cache(maxsize=KEPT)
def _turned(
    x: float, y: float, cosine: float, sine: float, half_width: float, half_height: float, projection: Projection
) -> Image | None:
    """Return the corners of a rotated rectangle, counter-clockwise from its own lower left one; see `_fixed`.

    They are cached, as most rectangles stand where they stood in the frame before.
    """
    a, b, c, d = cosine * half_width, sine * half_width, -sine * half_height, cosine * half_height
    corners = [(x - a - c, y - b - d), (x + a - c, y + b - d), (x + a + c, y + b + d), (x - a + c, y - b + d)]
    return _fixed(corners, projection)


def _fixed(corners: Sequence[Point], projection: Projection) -> Image | None:
    """Return points in OpenCV's fixed-point numbers, int32 (points, 2); None if they are too far out, or not finite."""
    unit, middle, down, far = projection
    if not sum([abs(x) + abs(y) for x, y in corners]) < far:
        return None
    return np.array([(round(middle + x * unit), round(down - y * unit)) for x, y in corners], np.int32)


def _whole(pixels: float) -> int:
    """Round, halves always up, so that a shape that moves by one pixel does not change its size."""
    return math.floor(pixels + 0.5)


@functools.lru_cache(maxsize=KEPT)
def _disc_at(pixels: float, x: int, y: int) -> Image:
    """Return `_disc` around a point; cached, as most bodies lie where they lay in the frame before."""
    return _disc(pixels) + np.array((x, y), np.int32)


@functools.lru_cache(maxsize=1024)
def _disc(pixels: float) -> Image:
    """Return a polygon that looks like a circle of this radius around 0, in OpenCV's fixed-point numbers."""
    count = 8 * math.ceil(math.pi / math.acos(1 - min(ERROR / pixels, 0.25)) / 8)
    return np.rint(_rim(count) * (pixels * UNIT)).astype(np.int32)


@functools.lru_cache(maxsize=1024)
def _rim(count: int) -> Image:
    """Return the corners of a regular polygon on the unit circle, float64 (count, 2)."""
    angles = np.arange(count) * (2 * math.pi / count)
    return np.stack([np.cos(angles), np.sin(angles)], 1)


@functools.lru_cache(maxsize=4096)
def _ink(words: str, scale: float, thick: int) -> tuple[float, float, float]:
    """Return where the ink of words begins and ends, and the middle of a digit's height, in pixels.

    They are relative to the point at which OpenCV starts to write. They are found by trial, as fonts depend on OpenCV's
    version.
    """
    xs, _ = _trial(words, scale, thick)
    _, ys = _trial("0", scale, thick)
    return xs[0], xs[1], (ys[0] + ys[1]) / 2


@functools.lru_cache(maxsize=4096)
def _trial(words: str, scale: float, thick: int) -> tuple[Point, Point]:
    """Return the ends of the ink, across and down, relative to the point at which OpenCV starts to write."""
    (width, height), below = cv2.getTextSize(words, cv2.FONT_HERSHEY_DUPLEX, scale, thick)
    margin = height + below + 2
    trial = np.zeros((2 * margin + height, 2 * margin + width), np.uint8)
    cv2.putText(trial, words, (margin, margin + height), cv2.FONT_HERSHEY_DUPLEX, scale, (255,), thick, cv2.LINE_AA)
    ys, xs = np.nonzero(trial)
    if not len(xs):
        return (0.0, 0.0), (0.0, 0.0)
    top = margin + height
    return (int(xs.min()) - margin, int(xs.max()) + 1 - margin), (int(ys.min()) - top, int(ys.max()) + 1 - top)
