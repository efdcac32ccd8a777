"""An index of bodies: living bodies near a point, in a rectangle, or on a ray.

    def burn(health: Write[Health], bodies: Bodies, agents: Bitset[Side], ...) -> None:
        for k in range(near(bodies, agents, x, y, reach)):
            e = bodies.rows[k]

A query lists rows in order, of `members`, a bitset by block, or of all bodies (None): all rows that may fit, and few
others, so an exact test follows. It tests the AABBs of sixteen rows at a time, or, with many bodies, of 64: then the
sides of all AABBs are also rounded outwards to a grid of 255 steps along each axis, so that each is a byte, and a
rectangle is compared with 64 rows in four instructions.

The first query of a system fills the index of a world, in memory of the thread: filling it in each system with
queries is faster than keeping one for every world outside of the fastest cache. A system without queries costs
almost nothing. Bodies that the system itself has moved or removed may or may not appear in later queries.
"""

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from outlast.components import Body, Polygon, Shape
from outlast.ecs import Array, Bitset, Entity, Read, Real, Service, kernel
from outlast.ecs.kernels.simd import (
    BYTES,
    LARGEST,
    NO_BYTE,
    SIMD_SHIFT,
    SIMD_WIDTH,
    load,
    overlap,
    store_bytes,
    to_bits,
    trailing_zeros,
)

from .aabb import ALONG_X, ALONG_Y, AABBs, aabbs_hit_by_ray, aabbs_in_box, aabbs_near_point, compute_aabbs
from .blocks import alive_bits, append_rows, first_row

FEW = 8  # up to this many blocks, testing each is faster
LOW_X, HIGH_X, LOW_Y, HIGH_Y = range(4)  # lines of `sides`
START, STEPS = 0, 1  # of each axis in `scale`: start of the first step, and steps per metre
X, Y = 0, 1  # axes
EVERY = (1 << SIMD_WIDTH) - 1  # all rows of a block
STALE = -1  # instead of the number of blocks
ZERO, ONE, LAST = np.float32(0), np.float32(1), np.float32(LARGEST)
PART = np.float32(1e-6)  # of coordinates: more than the rounding of float32


class Index(NamedTuple):
    """The index; kernels may read the first four fields after `refresh`, and `rows` after a query."""

    half_extents: Array  # float32 (2, rows): of the AABBs of all rows, along x and y; metres
    living: Array  # int32 (blocks,): bitsets of the living bodies
    lines: Array  # int32 (blocks,): numbers of the blocks with living bodies
    count: Array  # int32 (2,): their number, STALE until they are listed; whether `sides` are filled
    sides: Array  # uint8 (4, rows), in the order of `lines`, not of the tables
    scale: Array  # float32 (axes, 2): of `sides`
    words: Array  # int64 (2, words): bitsets of near rows, and the start of each in `sides`
    rows: Array  # int32 (rows,): rows found by the last query
    body: Any  # the tables that it is computed from, and the rows of bodies
    shape: Any
    entities: Any
    members: Any
    polygons: Any  # None in games without polygons


def make_index(dims: Mapping[str, int]) -> Index:
    """Return the memory of the index of one world."""
    blocks, words = dims["blocks"], -(-dims["blocks"] * SIMD_WIDTH // BYTES)
    many = words if blocks > FEW else 0
    return Index(
        half_extents=np.zeros((2, SIMD_WIDTH * blocks), np.float32),
        living=np.zeros(blocks, np.int32),
        lines=np.zeros(blocks, np.int32),
        count=np.full(2, STALE, np.int32),
        sides=np.zeros((4, BYTES * many), np.uint8),
        scale=np.ones((2, 2), np.float32),
        words=np.zeros((2, many + 1), np.int64),
        rows=np.zeros(SIMD_WIDTH * blocks, np.int32),
        body=None,
        shape=None,
        entities=None,
        members=None,
        polygons=None,
    )


def expire(
    index: Any,
    body: Read[Body],
    shape: Read[Shape],
    entities: Read[Entity],
    members: Bitset[Shape],
    polygons: Read[Polygon] | None,
) -> None:
    """Mark the index as stale, so that the first query of the next world or system fills it."""
    index.count[0] = STALE


Bodies: TypeAlias = Annotated[Any, Service(expire, make_index, behind=True)]
"""A parameter of systems: the index of all living bodies that have a Shape, an Index."""


@kernel
def refresh(index: Index) -> int:
    """Fill the index of a world, except `sides`, unless it is filled. Return the number of blocks with bodies."""
    if index.count[0] == STALE:
        compute_aabbs(index.half_extents, index.body, index.shape)
        count = 0
        for b in range(index.living.size):  # without a branch, which would be mispredicted about every other time
            bits = alive_bits(index.entities, index.members, b)
            index.living[b], index.lines[count] = bits, b
            count += bits != 0
        index.count[0], index.count[1] = count, 0
    return int(index.count[0])


@kernel
def near(index: Index, members: Array, x: Real, y: Real, distance: Real) -> int:
    """List the living `members` whose AABB is within `distance` of a point along both axes."""
    box = x - distance, x + distance, y - distance, y + distance
    return list_rows(index, members, box, aabbs_near_point, (x, y, distance))


@kernel
def discs_near(index: Index, members: Array, x: Real, y: Real, distance: Real) -> int:
    """List the living `members`, discs, that come within `distance` of a point.

    In a small room, it does not fill the index: a few direct tests cost less.
    """
    if members.size > FEW:
        return near(index, members, x, y, distance)
    body, shape, found = index.body, index.shape, 0
    for b in range(members.size):
        if members[b]:
            dx, dy = load(body.x, SIMD_WIDTH * b) - x, load(body.y, SIMD_WIDTH * b) - y
            most = load(shape.radius, SIMD_WIDTH * b) + distance
            within = alive_bits(index.entities, members, b) & to_bits(dx * dx + dy * dy <= most * most)
            found = append_rows(index.rows, found, b, within)
    return found


@kernel
def in_box(index: Index, members: Array, low_x: Real, high_x: Real, low_y: Real, high_y: Real) -> int:
    """List the living `members` whose AABB overlaps a rectangle."""
    box = low_x, high_x, low_y, high_y
    return list_rows(index, members, box, aabbs_in_box, box)


@kernel
def on_ray(index: Index, members: Array, x: Real, y: Real, dx: Real, dy: Real) -> int:
    """List the living `members` whose AABB the ray from (x, y) to (x + dx, y + dy) may hit."""
    box = min(x, x + dx), max(x, x + dx), min(y, y + dy), max(y, y + dy)
    return list_rows(index, members, box, aabbs_hit_by_ray, (x, y, dx, dy))


@kernel
def all_aabbs(index: Index) -> AABBs:
    """Return the AABBs of all rows, after `refresh`."""
    return index.body.x, index.body.y, index.half_extents[ALONG_X], index.half_extents[ALONG_Y]


@kernel
def list_rows(index: Index, members: Array, box: Any, test: Any, numbers: Any) -> int:
    """List the members for which `test(aabbs, block, *numbers)` holds; in a crowd, those in the rectangle `box`."""
    count = refresh(index)
    if count > FEW:  # with many bodies, a query is faster than a test of all
        return query(index, members, box[0], box[1], box[2], box[3])
    aabbs, found = all_aabbs(index), 0
    for k in range(count):
        b = index.lines[k]
        here = index.living[b] if members is None else index.living[b] & members[b]
        found = append_rows(index.rows, found, b, here & test(aabbs, b, *numbers))
    return found


@kernel
def round_sides(index: Index) -> None:
    """Round the sides of the AABBs of all living bodies to bytes; others get NO_BYTE, which overlaps nothing."""
    index.count[1] = 1
    sides, scale, count = index.sides, index.scale, index.count[0]
    xs, ys, half_x, half_y = all_aabbs(index)
    slack_x, slack_y = fit(scale[X], index, xs), fit(scale[Y], index, ys)
    for k in range(count):
        row, to, bits = SIMD_WIDTH * index.lines[k], SIMD_WIDTH * k, index.living[index.lines[k]]
        at, reach = load(xs, row) - scale[X, START], load(half_x, row) + slack_x
        store_bytes(sides[LOW_X], to, (at - reach) * scale[X, STEPS], bits)
        store_bytes(sides[HIGH_X], to, (at + reach) * scale[X, STEPS], EVERY)
        at, reach = load(ys, row) - scale[Y, START], load(half_y, row) + slack_y
        store_bytes(sides[LOW_Y], to, (at - reach) * scale[Y, STEPS], EVERY)
        store_bytes(sides[HIGH_Y], to, (at + reach) * scale[Y, STEPS], EVERY)
    for e in range(SIMD_WIDTH * count, -(-SIMD_WIDTH * count // BYTES) * BYTES):  # the rest of the last word
        sides[LOW_X, e] = NO_BYTE


@kernel
def fit(scale: Array, index: Index, centres: Array) -> Real:
    """Set the steps of an axis to cover the range of the lines' first rows. Return the slack of coordinates, metres.

    Coordinates beyond belong to the first or the last step.
    """
    low = high = centres[first_row(index.lines[0], index.living[index.lines[0]])]
    for k in range(1, index.count[0]):
        at = centres[first_row(index.lines[k], index.living[index.lines[k]])]
        low, high = min(low, at), max(high, at)
    scale[START], scale[STEPS] = low, LAST / max(high - low, ONE)
    return PART * (abs(low) + abs(high) + ONE)


@kernel
def step(scale: Array, at: Real) -> Any:
    """Return the step of a coordinate."""
    k = (at - scale[START]) * scale[STEPS]
    k = k if k > ZERO else ZERO  # also for NaN
    return np.uint8(np.int32(k if k < LAST else LAST))


@kernel
def query(index: Index, members: Array, low_x: Real, high_x: Real, low_y: Real, high_y: Real) -> int:
    """List the members whose AABB, rounded outwards to steps, overlaps a rectangle, in order. Return their number."""
    if index.count[1] == 0:
        round_sides(index)
    sides, scale, words = index.sides, index.scale, index.words
    first_x, last_x = step(scale[X], low_x), step(scale[X], high_x)
    first_y, last_y = step(scale[Y], low_y), step(scale[Y], high_y)
    some = 0
    for start in range(0, SIMD_WIDTH * index.count[0], BYTES):  # without a branch, which would often be mispredicted
        bits = overlap(sides[LOW_X], sides[HIGH_X], start, first_x, last_x)
        bits &= overlap(sides[LOW_Y], sides[HIGH_Y], start, first_y, last_y)
        words[0, some], words[1, some] = bits, start
        some += bits != 0
    found = k = 0
    pending = words[0, 0]
    while k < some:  # one loop over the rows of all words, since its end is mispredicted
        at = words[1, k] + trailing_zeros(pending)
        b, lane = index.lines[at >> SIMD_SHIFT], at & SIMD_WIDTH - 1
        index.rows[found] = SIMD_WIDTH * b + lane
        found += 1 if members is None else members[b] >> lane & 1
        pending &= pending - 1
        done = pending == 0
        k += done
        pending = words[0, k] if done else pending
    return found
