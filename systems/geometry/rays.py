"""Ray casts against circles, rectangles, convex polygons and entities.

Pure float32 scalar kernels. All lengths share one unit; box angles are given as cosine and sine. A ray is o + f * d for
0 <= f <= 1, and the kernels return the fraction f of the first hit, or NO_HIT. A shape that contains the ray's origin
is never hit.

Formulas follow Box2D 2.3: b2CircleShape::RayCast, b2PolygonShape::RayCast and ::TestPoint. Box2D takes a ray's
end points, so its direction is the rounded (o + d) - o. This rounding costs a nanosecond, and makes
the rays bit-identical to Box2D's (if neither compiler fuses multiply and add).
"""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.jit import noinline_kernel

from .points import to_local

NO_HIT = np.float32(2.0)  # any number above 1, so that min(fraction) over shapes needs no flag
ZERO = np.float32(0.0)
ONE = np.float32(1.0)
EPSILON = np.float32(1.1920929e-07)  # b2_epsilon; squared length below which a ray has no direction


@kernel
def ray_circle(ox: Real, oy: Real, dx: Real, dy: Real, cx: Real, cy: Real, radius: Real) -> Real:
    """Return the fraction at which the ray enters the circle, or NO_HIT (also from inside or if below 3.5e-4 long).

    A ray that starts on the rim and runs inwards hits at 0. A tangent hits.
    """
    sx, sy = ox - cx, oy - cy
    dx, dy = (ox + dx) - ox, (oy + dy) - oy
    along = sx * dx + sy * dy
    square = dx * dx + dy * dy
    discriminant = along * along - square * (sx * sx + sy * sy - radius * radius)
    if discriminant < ZERO or square < EPSILON:
        return NO_HIT
    root = -(along + np.float32(np.sqrt(discriminant)))
    if ZERO <= root <= square:
        return root / square
    return NO_HIT


@kernel
def ray_box(
    ox: Real,
    oy: Real,
    dx: Real,
    dy: Real,
    cx: Real,
    cy: Real,
    cosine: Real,
    sine: Real,
    half_width: Real,
    half_height: Real,
) -> Real:
    """Return the fraction at which the ray enters the rectangle, or NO_HIT (also from inside or on its edge).

    (half_width, half_height) lie along the body's own axes; (cosine, sine) is the body's angle. A ray along
    an edge or through a corner hits.
    """
    sx, sy = ox - cx, oy - cy
    beside, reach = sx * dy - sy * dx, half_width + half_height
    # Not in Box2D: most rays pass far from the centre, and a branch that mostly goes one way makes the kernel
    # twice as fast. Reach exceeds the half diagonal by far more than rounding errors.
    if beside * beside > (dx * dx + dy * dy) * (reach * reach):
        return NO_HIT
    x, y = to_local(sx, sy, cosine, sine)
    end_x, end_y = to_local(ox + dx - cx, oy + dy - cy, cosine, sine)
    across, upward = end_x - x, end_y - y
    # Mirror the scene so that the ray runs towards +x and +y: it can only enter by the left or lower side.
    if across < ZERO:
        x, across = -x, -across
    if upward < ZERO:
        y, upward = -y, -upward
    left, right = -half_width - x, half_width - x
    lower, upper = -half_height - y, half_height - y
    if right < ZERO or upper < ZERO or left > across or lower > upward:
        return NO_HIT  # starts beyond the slabs or ends before them: no division needed
    enter, leave = ZERO, ONE
    if across > ZERO:
        enter, leave = max(enter, left / across), min(leave, right / across)
    if upward > ZERO:
        enter, leave = max(enter, lower / upward), min(leave, upper / upward)
    if ZERO < enter <= leave:
        return enter
    return NO_HIT


@noinline_kernel
def ray_polygon(ox: Real, oy: Real, dx: Real, dy: Real, body: Array, polygons: Any, e: int) -> Real:
    """Return the fraction at which the ray enters polygon `e`, or NO_HIT (also from inside or on its edge)."""
    px, py, cosine, sine = body.x[e], body.y[e], body.cosine[e], body.sine[e]
    x, y = to_local(ox - px, oy - py, cosine, sine)
    end_x, end_y = to_local(ox + dx - px, oy + dy - py, cosine, sine)
    across, upward = end_x - x, end_y - y
    xs, ys, corners = polygons.x[e], polygons.y[e], polygons.corners[e]
    enter, leave, entered = ZERO, ONE, False
    for k in range(corners):
        normal_x, normal_y = edge_normal(xs, ys, corners, k)
        numerator = normal_x * (xs[k] - x) + normal_y * (ys[k] - y)
        denominator = normal_x * across + normal_y * upward
        if denominator < ZERO and numerator < enter * denominator:
            enter, entered = numerator / denominator, True
        elif denominator > ZERO and numerator < leave * denominator:
            leave = numerator / denominator
        if leave < enter or (denominator == ZERO and numerator < ZERO):
            return NO_HIT
    return enter if entered else NO_HIT


@kernel
def edge_normal(xs: Array, ys: Array, corners: int, k: int) -> tuple[Real, Real]:
    """Return the outer normal of edge k of a polygon, in its own frame, as b2PolygonShape::Set computes it."""
    n = (k + 1) % corners
    along_x, along_y = xs[n] - xs[k], ys[n] - ys[k]
    scale = ONE / np.float32(np.sqrt(along_x * along_x + along_y * along_y))
    return along_y * scale, -along_x * scale


@noinline_kernel
def ray_body(
    ox: Real,
    oy: Real,
    dx: Real,
    dy: Real,
    x: Real,
    y: Real,
    cosine: Real,
    sine: Real,
    radius: Real,
    half_width: Real,
    half_height: Real,
) -> Real:
    """Return the fraction at which the ray enters the body at (x, y), or NO_HIT: a circle if radius > 0, else a box."""
    if radius > ZERO:
        return ray_circle(ox, oy, dx, dy, x, y, radius)
    return ray_box(ox, oy, dx, dy, x, y, cosine, sine, half_width, half_height)


@kernel
def raycast_entity(
    body: Array, shape: Array, ox: Real, oy: Real, dx: Real, dy: Real, e: int, polygons: Any = None
) -> Real:
    """Return the fraction at which the ray enters entity `e`, or NO_HIT: `ray_body` on the tables Body and Shape.

    polygons: the table `Read[Polygon] | None`, as `polygons` of the index of bodies; without it, `e` is not a polygon.
    """
    if polygons is not None and polygons.corners[e] > 0:
        return ray_polygon(ox, oy, dx, dy, body, polygons, e)
    return ray_body(
        ox,
        oy,
        dx,
        dy,
        body.x[e],
        body.y[e],
        body.cosine[e],
        body.sine[e],
        shape.radius[e],
        shape.half_width[e],
        shape.half_height[e],
    )
