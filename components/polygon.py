"""Convex polygons: the outline of bodies that are neither discs nor rectangles."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from outlast.ecs import Array, Component, DeclarationError, column, kernel

from .body import Body, Shape
from .limits import FAR

LEAST, MOST = 3, 8  # corners
SLOP = np.float32(0.005)  # metres: b2_linearSlop, Box2D's contacts do not resolve smaller distances
SOUND, NEAR, OUTSIDE, FLAT = range(4)  # results of `flaw`
ZERO = np.float32(0)
EXAMPLE = "as in Polygon([(0, 0), (2, 0), (0, 1)])"


class Polygon(Component):
    """The outline of a body: a convex polygon of 3 to 8 corners, metres, in the body's own frame.

    Polygon([(0, 0), (2, 0), (0, 1)]) is a wedge. It brings the body's Shape, the rectangle around it. The position of
    the body is the polygon's centre of mass, for any origin of the corners. Corners may be given clockwise or not; they
    are stored counter-clockwise from the rightmost one, as in Box2D, and do not change later. Start positions, and the
    walls of rooms, use the rectangle or the circle around it.

    Args:
        corners: The corners, (x, y) each; or a list of such lists, one for each entity of the kind.

    Raises:
        DeclarationError: Corners are fewer than 3 or more than 8; they are not finite, or farther than 10 km from
            the origin; two are less than 5 mm apart; three are in line; or the polygon is not convex.
    """

    requires = (Body, Shape)
    corners: Array = column("i4", high=MOST)  # number of corners; 0: not a polygon
    x: Array = column("f4", MOST)  # metres
    y: Array = column("f4", MOST)

    def __init__(self, corners: Any) -> None:
        each = [_arranged(own) for own in (corners if _is_list_of_polygons(corners) else [corners])]
        counts = [len(own) for own in each]
        rows = np.array([np.pad(own, ((0, MOST - len(own)), (0, 0))) for own in each], np.float32)
        several = len(each) > 1
        super().__init__(
            corners=counts if several else counts[0],
            x=rows[:, :, 0] if several else rows[0, :, 0],
            y=rows[:, :, 1] if several else rows[0, :, 1],
        )

    def brings(self) -> tuple[Component, ...]:
        """Return the rectangle around the polygon."""
        half_width, half_height = (np.abs(self.fills[axis]).max(-1) for axis in "xy")
        return (Shape(half_width=half_width, half_height=half_height),)


def _is_list_of_polygons(corners: Any) -> bool:
    try:
        return isinstance(corners[0][0], Sequence | np.ndarray)
    except (TypeError, IndexError, KeyError):
        return False


def _arranged(corners: Any) -> Any:
    """Return corners around their centre of mass in Box2D's order, float32 (corners, 2), or raise DeclarationError."""
    name = f"Polygon({corners!r:.60})"
    try:
        given = np.array([(x, y) for x, y in corners], float)
    except (TypeError, ValueError):
        raise DeclarationError(f"{name}: a list of corners (x, y) in metres is needed, {EXAMPLE}") from None
    if not LEAST <= len(given) <= MOST:
        raise DeclarationError(
            f"{name} has {len(given)} corners: {LEAST} to {MOST} are possible; for more, weld several bodies"
        )
    for k, (x, y) in enumerate(given):
        if not (abs(x) <= FAR and abs(y) <= FAR):
            raise DeclarationError(f"{name}: corner {k} is ({x:g}, {y:g}); numbers up to {FAR:g} metres are needed")
    order = np.arange(len(given))
    if _area(given) < 0:
        order = order[::-1]
    points = (given[order] - _centre(given)).astype(np.float32)
    kind, k, j = flaw(points[:, 0], points[:, 1], len(points))
    a, b, c = order[k], order[(k + 1) % len(order)], order[j]
    if kind == NEAR:
        raise DeclarationError(f"{name}: corners {a} and {b} are less than 5 mm apart; leave one of them out")
    if kind == FLAT:
        raise DeclarationError(f"{name}: corners {a}, {b} and {c} are in line, within 5 mm; leave the middle one out")
    if kind == OUTSIDE:
        raise DeclarationError(
            f"{name} is not convex: corner {c} is outside of the edge from corner {a} to corner {b}; "
            "give its corners in order, or weld convex parts to each other"
        )
    first = np.lexsort((points[:, 1], -points[:, 0]))[0]
    return np.roll(points, -first, 0)


def _area(points: Any) -> float:
    """Return the area, square metres; negative for clockwise corners."""
    (x, y), (next_x, next_y) = points.T, np.roll(points, -1, 0).T
    return float((x * next_y - y * next_x).sum() / 2)


def _centre(points: Any) -> Any:
    """Return the centre of mass; for points in a line, their mean."""
    middle = points.mean(0)
    around = points - middle
    following = np.roll(around, -1, 0)
    crosses = around[:, 0] * following[:, 1] - around[:, 1] * following[:, 0]
    if abs(crosses.sum()) < float(SLOP) ** 2:
        return middle
    return middle + ((around + following) * crosses[:, None]).sum(0) / (3 * crosses.sum())


@kernel
def flaw(x: Any, y: Any, corners: int) -> tuple[int, int, int]:
    """Return the reason why counter-clockwise corners are not a convex polygon for Box2D, with the edge and corner.

    Args:
        x: x of each corner, metres, finite.
        y: y of each corner, metres, finite.
        corners: Number of corners, at least 3.

    Returns:
        (SOUND, 0, 0); (NEAR, k, k) if edge k, from corner k to the next, is too short; (OUTSIDE, k, j) if corner j is
        on the outer side of edge k; (FLAT, k, j) if it is in line with it.
    """
    found, edge, corner = SOUND, 0, 0
    for k in range(corners):
        along_x, along_y = x[(k + 1) % corners] - x[k], y[(k + 1) % corners] - y[k]
        length = np.float32(np.sqrt(along_x * along_x + along_y * along_y))
        if not length >= SLOP:
            return NEAR, k, k
        for step in range(2, corners):
            j = (k + step) % corners
            inwards = along_x * (y[j] - y[k]) - along_y * (x[j] - x[k])
            if inwards <= -SLOP * length:
                return OUTSIDE, k, j
            if not inwards >= SLOP * length and found == SOUND:
                found, edge, corner = FLAT, k, j
    return found, edge, corner


@kernel
def is_polygon(polygons: Any, e: int) -> bool:
    """Return whether body `e` is a polygon. polygons: the table `Read[Polygon] | None`."""
    if polygons is None:
        return False
    return bool(polygons.corners[e] > 0)
