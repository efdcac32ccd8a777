"""Exact questions about bodies: how far apart they are, which are near, what a ray meets, who sees whom.

    def explode(health: Write[Health], bodies: Bodies, agents: Bitset[Side], mines: Rows[Mine], reach: float, ...):
        for mine in mines:
            for k in range(within(bodies, agents, mine, reach)):
                e = bodies.rows[k]

Bodies are given by their rows, and `members` as a Bitset of the components that count (`bodies.members` is all). Lists
are in `bodies.rows`, in order, until the next query. Where several bodies are as near, the one with the smallest row
counts. env.query asks the same from Python.
"""

import numpy as np

from outlast.ecs import Array, Real, kernel

from .bodies import Index, near, on_ray
from .broad_phase import outer_radius
from .points import gap_circle_box, to_local
from .rays import NO_HIT, raycast_entity

NOBODY = -1
ZERO = np.float32(0)
STRETCH = np.float32(1 + 1e-6)  # the ray to a centre is this much longer, as in the original


@kernel
def distance_to(index: Index, e: int, x: Real, y: Real) -> Real:
    """Return the metres from a point to the outline of body `e`; 0 inside."""
    return max(_gap(index.body, index.shape, e, np.float32(x), np.float32(y)), ZERO)


@kernel
def distance(index: Index, e: int, o: int) -> Real:
    """Return the metres between the outlines of two bodies; 0 if they overlap."""
    body, shape = index.body, index.shape
    if shape.radius[e] > ZERO:
        return max(_gap(body, shape, o, body.x[e], body.y[e]) - shape.radius[e], ZERO)
    if shape.radius[o] > ZERO:
        return max(_gap(body, shape, e, body.x[o], body.y[o]) - shape.radius[o], ZERO)
    if max(_beyond(body, shape, e, o), _beyond(body, shape, o, e)) <= ZERO:
        return ZERO
    return max(min(_corner_gap(body, shape, e, o), _corner_gap(body, shape, o, e)), ZERO)


@kernel
def overlap(index: Index, e: int, o: int) -> bool:
    """Return whether two bodies overlap or touch, whatever their filters say."""
    return bool(distance(index, e, o) <= ZERO)


@kernel
def around(index: Index, members: Array, x: Real, y: Real, far: Real) -> int:
    """List the living `members` whose outline is at most `far` metres from a point; return how many there are."""
    found = 0
    for k in range(near(index, members, np.float32(x), np.float32(y), np.float32(far))):
        o = index.rows[k]
        index.rows[found] = o
        found += distance_to(index, o, x, y) <= far
    return found


@kernel
def within(index: Index, members: Array, e: int, far: Real) -> int:
    """List the other living `members` whose outline is at most `far` metres from that of body `e`; 0: that overlap it.

    Returns:
        How many there are.
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
        Its row, and the fraction of the ray at which it is entered; -1 and NO_HIT, 2, if there is none.
    """
    found, first = NOBODY, NO_HIT
    x, y, dx, dy = np.float32(x), np.float32(y), np.float32(dx), np.float32(dy)
    for k in range(on_ray(index, members, x, y, dx, dy)):
        o = index.rows[k]
        at = raycast_entity(index.body, index.shape, x, y, dx, dy, o)
        if o != skip and at < first:
            found, first = o, at
    return found, first


@kernel
def line_of_sight(index: Index, blockers: Array, e: int, o: int) -> bool:
    """Return whether none of the other living `blockers` is between the centre of body `e` and the outline of `o`.

    Whoever has its centre inside of `o` does not see it. Unlike the cameras, it looks around, and as far as need be.
    """
    x, y, dx, dy, reach = ray_to(index.body, index.shape, e, o)
    for k in range(on_ray(index, blockers, x, y, dx, dy)):
        other = index.rows[k]
        if other not in (e, o) and raycast_entity(index.body, index.shape, x, y, dx, dy, other) < reach:
            return False
    return bool(reach != NO_HIT)


@kernel
def ray_to(body: Array, shape: Array, e: int, o: int) -> tuple[Real, Real, Real, Real, Real]:
    """Return the ray from the centre of `e` to that of `o`: origin, direction, and fraction at which it enters `o`."""
    x, y = body.x[e], body.y[e]
    dx, dy = (body.x[o] - x) * STRETCH, (body.y[o] - y) * STRETCH
    return x, y, dx, dy, raycast_entity(body, shape, x, y, dx, dy, o)


@kernel
def _gap(body: Array, shape: Array, e: int, x: Real, y: Real) -> Real:
    """Return the metres from the outline of body `e` to a point; inside, minus those to the nearest side."""
    if shape.radius[e] > ZERO:
        dx, dy = x - body.x[e], y - body.y[e]
        return np.float32(np.sqrt(dx * dx + dy * dy)) - shape.radius[e]
    half_width, half_height = shape.half_width[e], shape.half_height[e]
    return gap_circle_box(x, y, ZERO, body.x[e], body.y[e], body.cosine[e], body.sine[e], half_width, half_height)


@kernel
def _beyond(body: Array, shape: Array, e: int, o: int) -> Real:
    """Return how far all of rectangle `e` is beyond one of the four sides of rectangle `o`; 0 or less if it is not."""
    x, y = to_local(body.x[e] - body.x[o], body.y[e] - body.y[o], body.cosine[o], body.sine[o])
    cosine, sine = to_local(body.cosine[e], body.sine[e], body.cosine[o], body.sine[o])
    width, height, cosine, sine = shape.half_width[e], shape.half_height[e], abs(cosine), abs(sine)
    beside = abs(x) - shape.half_width[o] - cosine * width - sine * height
    return max(beside, abs(y) - shape.half_height[o] - sine * width - cosine * height)


@kernel
def _corner_gap(body: Array, shape: Array, e: int, o: int) -> Real:
    """Return the metres from the outline of rectangle `o` to the nearest corner of rectangle `e`."""
    least = np.float32(np.inf)
    for k in range(4):
        along = shape.half_width[e] if k < 2 else -shape.half_width[e]
        across = shape.half_height[e] if k % 2 else -shape.half_height[e]
        x = body.x[e] + body.cosine[e] * along - body.sine[e] * across
        y = body.y[e] + body.sine[e] * along + body.cosine[e] * across
        least = min(least, _gap(body, shape, o, x, y))
    return least
