"""Visible floor: a camera's vision cone, on each ray up to the first body that blocks sight.

This is the reference for pictures and pages. As in the mechanic `cameras`, a ray ends where it enters a disc, a
rectangle or a convex polygon, a shape that contains the camera hides nothing, and a kite is bounded by the chords of
its arc.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

STEP = math.radians(1)  # angle between rays
ASIDE = 1e-5  # radians: rays so far to each side of an edge, one of which meets the body and one passes it
TINY = 1e-12  # metres: replaces a divisor of zero
BLOCKER = ("x", "y", "cosine", "sine", "radius", "half_width", "half_height")


def visible_corners(
    x: float,
    y: float,
    angle: float,
    fov: float,
    depth: float,
    kite: bool,
    blockers: Sequence[Sequence[float]] | Array,
    polygons: Sequence[Sequence[tuple[float, float]]] = (),
) -> Array:
    """Return the part of a vision cone that nothing hides.

    Args:
        x: The camera's place, metres.
        y: Likewise.
        angle: The direction in which it looks, radians.
        fov: The cone's opening angle, radians, up to pi.
        depth: How far it reaches, metres.
        kite: Whether the far rim is the two chords of the arc's halves instead of the arc.
        blockers: The bodies that block sight, without the camera's own, numbers (bodies, 7): x, y, cosine and sine of
            the angle, radius (0: a rectangle), half width, half height; see BLOCKER. NaNs hide nothing.
        polygons: More bodies that do: the corners of each, counter-clockwise, metres.

    Returns:
        Corners of a polygon, float64 (corners, 2), metres: first the camera's place, then the far rim,
        counter-clockwise. Every point of the polygon can be seen from its first corner.
    """
    half, bodies = fov / 2, np.asarray(blockers, float).reshape(-1, len(BLOCKER))
    bodies = _near(bodies[np.isfinite(bodies).all(1)], x, y, angle, half, depth)
    fan = np.linspace(-half, half, 2 * math.ceil(half / STEP) + 1)
    shapes = [np.asarray(corners, float) for corners in polygons if np.isfinite(corners).all()]
    bearing = [np.arctan2(corners[:, 1] - y, corners[:, 0] - x) for corners in shapes]
    edges = _edges(bodies, x, y, bearing) - angle
    edges = (edges + math.pi) % (2 * math.pi) - math.pi
    bearings = np.sort(np.concatenate([fan, edges[np.abs(edges) < half]]))
    rays = np.stack([np.cos(bearings + angle), np.sin(bearings + angle)], 1)
    rim = depth * math.cos(half / 2) / np.cos(np.abs(bearings) - half / 2) if kite else np.full(len(bearings), depth)
    reach = np.minimum(rim, _first_hit(rays, bodies, x, y))
    for corners in shapes:
        reach = np.minimum(reach, polygon_hits(rays, corners, x, y))
    return np.concatenate([[(x, y)], (x, y) + reach[:, None] * rays])


def _near(bodies: Array, x: float, y: float, angle: float, half: float, depth: float) -> Array:
    """Return the bodies that may reach into the cone."""
    to_x, to_y = bodies[:, 0] - x, bodies[:, 1] - y
    bound = np.maximum(bodies[:, 4], np.hypot(bodies[:, 5], bodies[:, 6]))
    ahead, aside = math.cos(angle) * to_x + math.sin(angle) * to_y, math.cos(angle) * to_y - math.sin(angle) * to_x
    beside = math.cos(half) * np.abs(aside) - math.sin(half) * ahead  # metres outwards from the nearer edge of the cone
    near: Array = bodies[(beside <= bound) & (np.hypot(to_x, to_y) <= depth + bound)]
    return near


def _edges(bodies: Array, x: float, y: float, more: Sequence[Array]) -> Array:
    """Return bearings, in the world's frame, of rays at, just before and just after the edges that the camera sees."""
    discs, boxes = bodies[bodies[:, 4] > 0], bodies[bodies[:, 4] <= 0]
    middle = np.arctan2(discs[:, 1] - y, discs[:, 0] - x)
    far = np.maximum(np.hypot(discs[:, 0] - x, discs[:, 1] - y), discs[:, 4])
    width = np.arcsin(np.minimum(discs[:, 4] / np.maximum(far, TINY), 1))
    across, up = boxes[:, 5, None] * (1, 1, -1, -1), boxes[:, 6, None] * (1, -1, 1, -1)
    corner_x = boxes[:, 0, None] - x + across * boxes[:, 2, None] - up * boxes[:, 3, None]
    corner_y = boxes[:, 1, None] - y + across * boxes[:, 3, None] + up * boxes[:, 2, None]
    edges = np.concatenate([middle - width, middle + width, np.arctan2(corner_y, corner_x).ravel(), *more])
    return np.concatenate([edges - ASIDE, edges, edges + ASIDE])


def _first_hit(rays: Array, bodies: Array, x: float, y: float) -> Array:
    """Return the metres along each ray to the first body that it enters, float64 (rays,); infinite if there is none."""
    if not len(bodies):
        return np.full(len(rays), math.inf)
    discs, boxes = bodies[bodies[:, 4] > 0], bodies[bodies[:, 4] <= 0]
    hits = np.concatenate([_disc_hits(rays, discs, x, y), _box_hits(rays, boxes, x, y)], 1)
    nearest: Array = hits.min(1)
    return nearest


def _disc_hits(rays: Array, discs: Array, x: float, y: float) -> Array:
    """Return the metres along each ray to where it enters each disc, float64 (rays, discs)."""
    to_x, to_y = discs[:, 0] - x, discs[:, 1] - y
    along = rays[:, :1] * to_x + rays[:, 1:] * to_y
    inside = along**2 - (to_x**2 + to_y**2 - discs[:, 4] ** 2)  # the square of half the chord along the ray
    enter = along - np.sqrt(np.maximum(inside, 0))
    return np.where((inside >= 0) & (enter >= 0), enter, math.inf)


def _box_hits(rays: Array, boxes: Array, x: float, y: float) -> Array:
    """Return the same for rectangles, float64 (rays, boxes), from the slabs of each one in its own frame."""
    cosine, sine = boxes[:, 2], boxes[:, 3]
    from_x, from_y = x - boxes[:, 0], y - boxes[:, 1]
    enter, leave = np.full((len(rays), len(boxes)), -math.inf), np.full((len(rays), len(boxes)), math.inf)
    for place, speed, half in (
        (cosine * from_x + sine * from_y, rays[:, :1] * cosine + rays[:, 1:] * sine, boxes[:, 5]),
        (cosine * from_y - sine * from_x, rays[:, 1:] * cosine - rays[:, :1] * sine, boxes[:, 6]),
    ):
        speed = np.where(np.abs(speed) < TINY, TINY, speed)
        one, other = (-half - place) / speed, (half - place) / speed
        enter, leave = np.maximum(enter, np.minimum(one, other)), np.minimum(leave, np.maximum(one, other))
    return np.where((enter > 0) & (enter <= leave), enter, math.inf)


def polygon_hits(rays: Array, corners: Array, x: float, y: float) -> Array:
    """Return the metres along each ray from (x, y) to where it enters a convex polygon, float64 (rays,).

    Args:
        rays: Directions, float64 (rays, 2), of length 1.
        corners: Counter-clockwise, float64 (corners, 2), metres.
        x: Where the rays begin, metres; a polygon that contains this point is not entered.
        y: Likewise.
    """
    along = np.roll(corners, -1, 0) - corners
    normals = np.stack([along[:, 1], -along[:, 0]])
    ahead = ((corners - (x, y)) * normals.T).sum(1)  # how far outside each side the origin is, negative
    speed = rays @ normals
    at = ahead / np.where(speed == 0, TINY, speed)
    enter = np.where(speed < 0, at, -math.inf).max(1)
    leave = np.where(speed > 0, at, math.inf).min(1)
    missed = ((speed == 0) & (ahead < 0)).any(1)
    return np.where((enter > 0) & (enter <= leave) & ~missed, enter, math.inf)
