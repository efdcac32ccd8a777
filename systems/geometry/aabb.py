"""Axis-aligned bounding boxes (AABBs) of all rows, and culling: the rows, of sixteen at a time, that a ray may hit.

Rays and contacts test one body against all others, and nearly all answers are no. The functions here take a block of
rows and return a bitset (see blocks) of all rows that may be hit, and few others; only these get the
exact test. Each AABB is enlarged by SLACK, so that rounding never loses a hit, in rooms of up to a hundred metres. Over
longer distances the exact tests, which are Box2D's, have errors of millimetres, and grazes may be culled.

    for k in range(bodies.count[0]):
        b = bodies.lines[k]
        pending = bodies.living[b] & aabbs_hit_by_ray(all_aabbs(bodies), b, x, y, dx, dy)
"""

from typing import Any, TypeAlias

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, store, to_bits

AABBs: TypeAlias = tuple[Array, Array, Array, Array]
"""Columns of all rows: centre x and y, half extent along x and y; metres."""

ALONG_X, ALONG_Y = 0, 1  # rows of `half_extents`
SLACK = np.float32(1e-3)  # metres: more than the rounding of a test in float32
HALF = np.float32(0.5)


def make_half_extents(dims: dict[str, int]) -> np.ndarray[Any, Any]:
    """Return scratch memory for `compute_aabbs`: float32 (2, rows), rounded up to full blocks."""
    return np.zeros((2, SIMD_WIDTH * dims["blocks"]), np.float32)


@kernel
def compute_aabbs(half_extents: Array, body: Array, shape: Array) -> AABBs:
    """Return the AABBs of all rows at their present positions; half extents are written to `half_extents`."""
    for start in range(0, half_extents.shape[1], SIMD_WIDTH):
        cosine, sine = abs(load(body.cosine, start)), abs(load(body.sine, start))
        width, height = load(shape.half_width, start), load(shape.half_height, start)
        radius = load(shape.radius, start) + SLACK
        store(half_extents[ALONG_X], start, cosine * width + sine * height + radius)
        store(half_extents[ALONG_Y], start, sine * width + cosine * height + radius)
    return body.x, body.y, half_extents[ALONG_X], half_extents[ALONG_Y]


@kernel
def aabbs_near_point(aabbs: AABBs, b: int, x: Real, y: Real, distance: Real) -> int:
    """Return the bitset of rows of block `b` whose AABB comes within `distance` of the point along both axes."""
    xs, ys, half_x, half_y = aabbs
    near_x = abs(load(xs, SIMD_WIDTH * b) - x) <= load(half_x, SIMD_WIDTH * b) + distance
    return int(to_bits(near_x & (abs(load(ys, SIMD_WIDTH * b) - y) <= load(half_y, SIMD_WIDTH * b) + distance)))


@kernel
def aabbs_in_box(aabbs: AABBs, b: int, low_x: Real, high_x: Real, low_y: Real, high_y: Real) -> int:
    """Return the bitset of rows of block `b` whose AABB overlaps a rectangle."""
    xs, ys, halves_x, halves_y = aabbs
    x, half_x = load(xs, SIMD_WIDTH * b), load(halves_x, SIMD_WIDTH * b)
    y, half_y = load(ys, SIMD_WIDTH * b), load(halves_y, SIMD_WIDTH * b)
    overlap_x = (x - half_x <= high_x) & (x + half_x >= low_x)
    return int(to_bits(overlap_x & (y - half_y <= high_y) & (y + half_y >= low_y)))


@kernel
def aabbs_hit_by_ray(aabbs: AABBs, b: int, ox: Real, oy: Real, dx: Real, dy: Real) -> int:
    """Return the bitset of rows of block `b` whose AABB the ray o + f d, 0 <= f <= 1, hits (a separating-axis test)."""
    xs, ys, halves_x, halves_y = aabbs
    wide, high = abs(dx), abs(dy)
    half_x, half_y = load(halves_x, SIMD_WIDTH * b), load(halves_y, SIMD_WIDTH * b)
    x, y = load(xs, SIMD_WIDTH * b) - ox - HALF * dx, load(ys, SIMD_WIDTH * b) - oy - HALF * dy  # from the ray's middle
    near = (abs(x) <= half_x + HALF * wide) & (abs(y) <= half_y + HALF * high)
    return int(to_bits(near & (abs(x * dy - y * dx) <= half_x * high + half_y * wide)))
