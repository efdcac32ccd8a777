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


def visible_corners(
    x: float,
    y: float,
    angle: float,
    fov: float,
    depth: float,
    kite: bool,
    discs: Sequence[Sequence[float]],
    polygons: Sequence[Sequence[tuple[float, float]]] = (),
) -> Array:
    """Return the part of a vision cone that nothing hides.

    Args:
        x: The camera's place, metres.
        y: Its second coordinate, metres.
        angle: The direction in which it looks, radians.
        fov: The cone's opening angle, radians, up to pi.
        depth: How far it reaches, metres.
        kite: Whether the far rim is the two chords of the arc's halves instead of the arc.
        discs: The discs that block sight, without the camera's own body: x, y and radius, metres. NaNs hide nothing.
        polygons: The corners of each rectangle or convex polygon that does, counter-clockwise, metres.

    Returns:
        Corners of a polygon, float64 (corners, 2), metres: first the camera's place, then the far rim,
        counter-clockwise. Every point of the polygon can be seen from its first corner.
    """
    half, most = fov / 2, max(map(len, polygons), default=1)
    round_ = _finite(np.array(discs, float).reshape(-1, 3))
    # shorter ones end in equal corners, which bound nothing
    padded = [[*each, *[each[-1]] * (most - len(each))] for each in polygons]
    edged = _finite(np.array(padded, float).reshape(-1, most, 2))
    middles = edged.mean(1)
    bounds = np.hypot(*(edged - middles[:, None]).transpose(2, 0, 1)).max(1)
    edged = edged[_near(middles, bounds, x, y, angle, half, depth)]
    round_ = round_[_near(round_[:, :2], round_[:, 2], x, y, angle, half, depth)]
    fan = np.linspace(-half, half, 2 * math.ceil(half / STEP) + 1)
    edges = (_edges(round_, edged, x, y) - angle + math.pi) % (2 * math.pi) - math.pi
    bearings = np.unique(np.concatenate([fan, edges[np.abs(edges) < half]]))
    rays = np.stack([np.cos(bearings + angle), np.sin(bearings + angle)], 1)
    rim = depth * math.cos(half / 2) / np.cos(np.abs(bearings) - half / 2) if kite else np.full(len(bearings), depth)
    reach = np.concatenate([rim[:, None], _disc_hits(rays, round_, x, y), polygon_hits(rays, edged, x, y)], 1).min(1)
    return np.concatenate([[(x, y)], (x, y) + reach[:, None] * rays])


def _finite(bodies: Array) -> Array:
    """Return those of the bodies, (bodies, ...), all of whose numbers are finite."""
    return bodies[np.isfinite(bodies).all(tuple(range(1, bodies.ndim)))]


def _near(middles: Array, bounds: Array, x: float, y: float, angle: float, half: float, depth: float) -> Array:
    """Return which bodies may reach into the cone, bool (bodies,)."""
    to_x, to_y = middles[:, 0] - x, middles[:, 1] - y
    ahead, aside = math.cos(angle) * to_x + math.sin(angle) * to_y, math.cos(angle) * to_y - math.sin(angle) * to_x
    beside = math.cos(half) * np.abs(aside) - math.sin(half) * ahead  # metres outwards from the nearer edge of the cone
    return (beside <= bounds) & (np.hypot(to_x, to_y) <= depth + bounds)


def _edges(discs: Array, polygons: Array, x: float, y: float) -> Array:
    """Return bearings, in the world's frame, of rays at, just before and just after the edges that the camera sees."""
    middle = np.arctan2(discs[:, 1] - y, discs[:, 0] - x)
    far = np.maximum(np.hypot(discs[:, 0] - x, discs[:, 1] - y), discs[:, 2])
    width = np.arcsin(np.minimum(discs[:, 2] / np.maximum(far, TINY), 1))
    corners = np.arctan2(polygons[..., 1] - y, polygons[..., 0] - x).ravel()
    edges = np.concatenate([middle - width, middle + width, corners])
    return np.concatenate([edges - ASIDE, edges, edges + ASIDE])


def _disc_hits(rays: Array, discs: Array, x: float, y: float) -> Array:
    """Return the metres along each ray to where it enters each disc, float64 (rays, discs)."""
    to_x, to_y = discs[:, 0] - x, discs[:, 1] - y
    along = rays[:, :1] * to_x + rays[:, 1:] * to_y
    inside = along**2 - (to_x**2 + to_y**2 - discs[:, 2] ** 2)  # the square of half the chord along the ray
    enter = along - np.sqrt(np.maximum(inside, 0))
    return np.where((inside >= 0) & (enter >= 0), enter, math.inf)


def polygon_hits(rays: Array, polygons: Array, x: float, y: float) -> Array:
    """Return the metres along each ray from (x, y) to where it enters each convex polygon, float64 (rays, polygons).

    Args:
        rays: Directions, float64 (rays, 2), of length 1.
        polygons: Corners, counter-clockwise, float64 (polygons, corners, 2), metres.
        x: Where the rays begin, metres; a polygon that contains this point is not entered.
        y: Their second coordinate, metres.
    """
    along = np.roll(polygons, -1, 1) - polygons
    normals = np.stack([along[..., 1], -along[..., 0]], -1)
    ahead = ((polygons - (x, y)) * normals).sum(-1)  # how far outside each side the origin is, negative
    speed = (rays @ normals.reshape(-1, 2).T).reshape(len(rays), *ahead.shape)
    at = ahead / np.where(speed == 0, TINY, speed)
    enter = np.where(speed < 0, at, -math.inf).max(-1)
    leave = np.where(speed > 0, at, math.inf).min(-1)
    missed = ((speed == 0) & (ahead < 0)).any(-1)
    return np.where((enter > 0) & (enter <= leave) & ~missed, enter, math.inf)
