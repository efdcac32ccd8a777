"""Exact questions about bodies: distances, neighbours, rays and lines of sight.

    def explode(health: Write[Health], bodies: Bodies, agents: Bitset[Side], mines: Rows[Mine], reach: float, ...):
        for mine in mines:
            for k in range(within(bodies, agents, mine, reach)):
                e = bodies.rows[k]

Bodies are given by their rows, and `members` as a Bitset of components (`bodies.members`: all bodies). Lists
are in `bodies.rows`, in order, until the next query. Of equally near bodies, the one with the smallest row
counts. env.query offers the same to Python.
"""

from typing import Any

import numpy as np

from outlast.components.polygon import is_polygon
from outlast.ecs import Array, Real, kernel

from .bodies import Index, near, on_ray
from .broad_phase import outer_radius
from .corners import corner, corner_count, outline_gap
from .points import gap_circle_box, to_local
from .rays import NO_HIT, raycast_entity

NOBODY = -1
ZERO = np.float32(0)
STRETCH = np.float32(1 + 1e-6)  # the ray to a centre is this much longer, as in the original


@kernel
def distance_to(index: Index, e: int, x: Real, y: Real) -> Real:
    """Return the metres from a point to the outline of body `e`; 0 inside."""
    return max(_gap(index, e, np.float32(x), np.float32(y)), ZERO)


@kernel
def distance(index: Index, e: int, o: int) -> Real:
    """Return the metres between the outlines of two bodies; 0 if they overlap."""
    body, shape = index.body, index.shape
    if shape.radius[e] > ZERO:
        return max(_gap(index, o, body.x[e], body.y[e]) - shape.radius[e], ZERO)
    if shape.radius[o] > ZERO:
        return max(_gap(index, e, body.x[o], body.y[o]) - shape.radius[o], ZERO)
    if _beyond(index, e, o) or _beyond(index, o, e):
        return max(min(_corner_gap(index, e, o), _corner_gap(index, o, e)), ZERO)
    return ZERO


@kernel
def overlap(index: Index, e: int, o: int) -> bool:
    """Return whether two bodies overlap or touch, regardless of their filters."""
    return bool(distance(index, e, o) <= ZERO)


@kernel
def around(index: Index, members: Array, x: Real, y: Real, far: Real) -> int:
    """List the living `members` whose outline is at most `far` metres from a point. Return their number."""
    found = 0
    for k in range(near(index, members, np.float32(x), np.float32(y), np.float32(far))):
        o = index.rows[k]
        index.rows[found] = o
        found += distance_to(index, o, x, y) <= far
    return found


@kernel
def within(index: Index, members: Array, e: int, far: Real) -> int:
    """List the other living `members` whose outline is at most `far` metres from that of body `e`; 0: overlaps.

    Returns:
        Their number.
    """
    found, reach = 0, outer_radius(index.shape, e) + np.float32(far)
    for k in range(near(index, members, index.body.x[e], index.body.y[e], reach)):
        o = index.rows[k]
        index.rows[found] = o
        found += o != e and distance(index, e, o) <= far
    return found


@kernel
def nearest(index: Index, members: Array, e: int, far: Real) -> int:
    """Return the other living member whose outline is nearest to that of body `e`, at most `far` metres; -1: none."""
    found, least = NOBODY, np.float32(far)
    for k in range(within(index, members, e, far)):
        o = index.rows[k]
        way = distance(index, e, o)
        if found < 0 or way < least:
            found, least = o, way
    return found


@kernel
def first_on_ray(index: Index, members: Array, x: Real, y: Real, dx: Real, dy: Real, skip: int) -> tuple[int, Real]:
    """Return the first living member that the ray from (x, y) to (x + dx, y + dy) enters, without the body `skip`.

    A body that contains (x, y) is not entered.

    Returns:
        Its row, and the fraction of the ray at which it is entered; -1 and NO_HIT, 2, without a hit.
    """
    found, first = NOBODY, NO_HIT
    x, y, dx, dy = np.float32(x), np.float32(y), np.float32(dx), np.float32(dy)
    for k in range(on_ray(index, members, x, y, dx, dy)):
        o = index.rows[k]
        at = raycast_entity(index.body, index.shape, x, y, dx, dy, o, index.polygons)
        if o != skip and at < first:
            found, first = o, at
    return found, first


@kernel
def line_of_sight(index: Index, blockers: Array, e: int, o: int) -> bool:
    """Return whether none of the other living `blockers` is between the centre of body `e` and the outline of `o`.

    From a centre inside of `o`, the result is False. Unlike for cameras, direction and distance do not matter.
    """
    body, shape, polygons = index.body, index.shape, index.polygons
    x, y, dx, dy, reach = ray_to(body, shape, polygons, e, o)
    for k in range(on_ray(index, blockers, x, y, dx, dy)):
        other = index.rows[k]
        if other not in (e, o) and raycast_entity(body, shape, x, y, dx, dy, other, polygons) < reach:
            return False
    return bool(reach != NO_HIT)


@kernel
def ray_to(body: Array, shape: Array, polygons: Any, e: int, o: int) -> tuple[Real, Real, Real, Real, Real]:
    """Return the ray from the centre of `e` to that of `o`: origin, direction, and fraction at which it enters `o`."""
    x, y = body.x[e], body.y[e]
    dx, dy = (body.x[o] - x) * STRETCH, (body.y[o] - y) * STRETCH
    return x, y, dx, dy, raycast_entity(body, shape, x, y, dx, dy, o, polygons)


@kernel
def _gap(index: Index, e: int, x: Real, y: Real) -> Real:
    """Return the metres from the outline of body `e` to a point; inside, negative: to the nearest side."""
    body, shape, polygons = index.body, index.shape, index.polygons
    if shape.radius[e] > ZERO:
        dx, dy = x - body.x[e], y - body.y[e]
        return np.float32(np.sqrt(dx * dx + dy * dy)) - shape.radius[e]
    if is_polygon(polygons, e):
        x, y = to_local(x - body.x[e], y - body.y[e], body.cosine[e], body.sine[e])
        return outline_gap(shape, polygons, e, x, y)
    half_width, half_height = shape.half_width[e], shape.half_height[e]
    return gap_circle_box(x, y, ZERO, body.x[e], body.y[e], body.cosine[e], body.sine[e], half_width, half_height)


@kernel
def _beyond(index: Index, e: int, o: int) -> bool:
    """Return whether all of body `e` is beyond one of the sides of body `o`; neither is a disc."""
    shape, polygons, corners = index.shape, index.polygons, corner_count(index.polygons, e)
    for k in range(corner_count(polygons, o)):
        from_x, from_y = corner(shape, polygons, o, k)
        to_x, to_y = corner(shape, polygons, o, k + 1)
        outside = 0
        for j in range(corners):
            x, y = _corner_at(index, e, j)
            x, y = to_local(x - index.body.x[o], y - index.body.y[o], index.body.cosine[o], index.body.sine[o])
            outside += (to_x - from_x) * (y - from_y) < (to_y - from_y) * (x - from_x)
        if outside == corners:
            return True
    return False


@kernel
def _corner_at(index: Index, e: int, k: int) -> tuple[Real, Real]:
    """Return the position of corner k of body `e`."""
    body, (along, across) = index.body, corner(index.shape, index.polygons, e, k)
    x = body.x[e] + body.cosine[e] * along - body.sine[e] * across
    return x, body.y[e] + body.sine[e] * along + body.cosine[e] * across


@kernel
def _corner_gap(index: Index, e: int, o: int) -> Real:
    """Return the metres from the outline of body `o` to the nearest corner of body `e`; neither is a disc."""
    least = np.float32(np.inf)
    for k in range(corner_count(index.polygons, e)):
        x, y = _corner_at(index, e, k)
        least = min(least, _gap(index, o, x, y))
    return least
