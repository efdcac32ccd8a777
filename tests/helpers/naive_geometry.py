"""Naive forms of the geometry kernels: float64, one entity at a time, derived in different ways."""

import math
from collections.abc import Sequence

import numpy as np

NO_HIT = 2.0
Point = tuple[float, float]


def ray_circle(o: Point, d: Point, centre: Point, radius: float) -> float:
    """Fraction at which o + f * d enters the circle, by Pythagoras on the perpendicular's foot; or NO_HIT."""
    length = math.hypot(*d)
    to_centre = (centre[0] - o[0], centre[1] - o[1])
    if length == 0 or math.hypot(*to_centre) < radius:
        return NO_HIT
    foot = (to_centre[0] * d[0] + to_centre[1] * d[1]) / length
    height = (to_centre[0] * d[1] - to_centre[1] * d[0]) / length
    if abs(height) > radius:
        return NO_HIT
    entry = foot - math.sqrt(radius**2 - height**2)
    return entry / length if 0 <= entry <= length else NO_HIT


def box_corners(centre: Point, angle: float, half_width: float, half_height: float) -> list[Point]:
    """The rectangle's four corners, counter-clockwise, in the world."""
    turn = complex(math.cos(angle), math.sin(angle))
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = [complex(*centre) + turn * complex(sx * half_width, sy * half_height) for sx, sy in signs]
    return [(corner.real, corner.imag) for corner in corners]


def in_polygon(p: Point, corners: Sequence[Point]) -> bool:
    """Whether p lies in the convex, counter-clockwise polygon: on the left of, or on, each side."""
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) < 0:
            return False
    return True


def edge_distance(p: Point, corners: Sequence[Point]) -> float:
    """Distance of p to the nearest side of the polygon."""
    return min(_segment_distance(p, a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True))


def _segment_distance(p: Point, a: Point, b: Point) -> float:
    start, end, point = np.array(a), np.array(b), np.array(p)
    side = end - start
    square = side @ side
    share = np.clip((point - start) @ side / square, 0, 1) if square > 0 else 0.0
    return float(np.linalg.norm(point - start - share * side))


def ray_box(o: Point, d: Point, centre: Point, angle: float, half_width: float, half_height: float) -> float:
    """Fraction of the first crossing of o + f * d with a side of the box; NO_HIT if none or from inside."""
    return ray_polygon(o, d, box_corners(centre, angle, half_width, half_height))


def ray_polygon(o: Point, d: Point, corners: Sequence[Point]) -> float:
    """The same with a side of the polygon."""
    if in_polygon(o, corners):
        return NO_HIT
    sides = zip(corners, [*corners[1:], corners[0]], strict=True)
    return min(_segments_cross(o, d, a, b) for a, b in sides)


def _segments_cross(o: Point, d: Point, a: Point, b: Point) -> float:
    """Solve o + f d = a + g (b - a) for 0 <= f, g <= 1 (Cramer); a parallel side is left to its two neighbours."""
    side, away = (b[0] - a[0], b[1] - a[1]), (a[0] - o[0], a[1] - o[1])
    determinant = d[0] * side[1] - d[1] * side[0]
    if determinant == 0:
        return NO_HIT
    f = (away[0] * side[1] - away[1] * side[0]) / determinant
    g = (away[0] * d[1] - away[1] * d[0]) / determinant
    return f if 0 <= f <= 1 and 0 <= g <= 1 else NO_HIT


def kite_corners(o: Point, heading: float, depth: float, half_fov: float) -> list[Point]:
    """The camera's quadrilateral, counter-clockwise from its apex."""
    angles = (heading - half_fov, heading, heading + half_fov)
    return [o, *((o[0] + depth * math.cos(angle), o[1] + depth * math.sin(angle)) for angle in angles)]


def in_kite(p: Point, o: Point, heading: float, depth: float, half_fov: float) -> bool:
    """Whether p lies in one of the two triangles to the right and left of the line of sight."""
    apex, right, ahead, left = kite_corners(o, heading, depth, half_fov)
    return in_polygon(p, [apex, right, ahead]) or in_polygon(p, [apex, ahead, left])


def in_sector(p: Point, o: Point, heading: float, depth: float, half_fov: float) -> bool:
    """Whether p is at most depth away and at most half_fov off the heading."""
    away = complex(p[0] - o[0], p[1] - o[1]) / complex(math.cos(heading), math.sin(heading))
    return abs(away) <= depth and abs(math.atan2(away.imag, away.real)) <= half_fov


def gap_circle_box(
    centre: Point, radius: float, box: Point, angle: float, half_width: float, half_height: float
) -> float:
    """Distance from the centre to the rectangle's nearest side, negative inside, less the radius."""
    corners = box_corners(box, angle, half_width, half_height)
    distance = edge_distance(centre, corners)
    return (-distance if in_polygon(centre, corners) else distance) - radius
