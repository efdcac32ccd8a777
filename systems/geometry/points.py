"""Places of points: in another body's frame, in a vision cone, distances from a rectangle.

Pure float32 scalar kernels. All lengths share one unit; headings and box angles are given as cosine and sine.
"""

from typing import Any

import numpy as np

from outlast.ecs import Real, kernel

ZERO = np.float32(0.0)
ONE = np.float32(1.0)


@kernel
def to_local(x: Real, y: Real, cosine: Real, sine: Real) -> tuple[Real, Real]:
    """Return vector (x, y) in the frame of a body turned by the angle (b2MulT)."""
    return cosine * x + sine * y, cosine * y - sine * x


@kernel
def in_kite(
    px: Real,
    py: Real,
    ox: Real,
    oy: Real,
    cosine: Real,
    sine: Real,
    depth: Real,
    half_fov_cos: Real,
    half_fov_sin: Real,
) -> Any:
    """Return whether point p lies in the camera's quadrilateral, border included.

    Its corners: the apex o, the two points at distance depth and +-half_fov from the heading (cosine, sine),
    and the point at depth straight ahead. Its far sides are chords, so between axis and edge it reaches less
    far than `in_sector`. 0 < half_fov < 180 degrees. Also takes sixteen points at once (ecs.kernels.simd).
    """
    x, y = to_local(px - ox, py - oy, cosine, sine)
    y = abs(y)  # the kite is its own mirror image: two of its four sides suffice
    beside = half_fov_cos * y - half_fov_sin * x
    beyond = half_fov_sin * (x - depth) + (ONE - half_fov_cos) * y
    return (beside <= ZERO) & (beyond <= ZERO)


@kernel
def in_sector(
    px: Real,
    py: Real,
    ox: Real,
    oy: Real,
    cosine: Real,
    sine: Real,
    depth: Real,
    half_fov_cos: Real,
    half_fov_sin: Real,
) -> Any:
    """Return whether point p lies in the circular sector of radius depth and +-half_fov, border included.

    Also takes sixteen points at once (ecs.kernels.simd).
    """
    x, y = to_local(px - ox, py - oy, cosine, sine)
    beside = half_fov_cos * abs(y) - half_fov_sin * x
    return (beside <= ZERO) & (x * x + y * y <= depth * depth)


@kernel
def gap_circle_box(
    cx: Real, cy: Real, radius: Real, bx: Real, by: Real, cosine: Real, sine: Real, half_width: Real, half_height: Real
) -> Real:
    """Return the distance from the circle's rim to the rectangle's edge; if they overlap, minus the depth."""
    x, y = to_local(cx - bx, cy - by, cosine, sine)
    x, y = abs(x) - half_width, abs(y) - half_height
    if x <= ZERO or y <= ZERO:
        return max(x, y) - radius  # nearest a side, or the centre is inside: no square root
    return np.float32(np.sqrt(x * x + y * y)) - radius
