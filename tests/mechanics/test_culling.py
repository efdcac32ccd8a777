"""Culling by AABBs, and the broad phase: nothing is culled that is hit, seen or touched."""

import math
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outlast.ecs import kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH
from outlast.systems.geometry import aabb, blocks, broad_phase, spatial_index
from outlast.systems.geometry.rays import NO_HIT
from tests.conftest import COMPILED
from tests.helpers import naive_geometry as naive

BLOCKS = 5
ROWS = BLOCKS * SIMD_WIDTH - 5  # the last block is not full
F4 = np.float32
SLACK = 2e-4  # metres: what float32 may lose in a sum of a few numbers of a room's size
SOME = settings(max_examples=150 if COMPILED else 15, deadline=None, derandomize=True)


class Body(NamedTuple):
    """The columns of components.Body that sweeps look at; a column is followed by room for a whole block."""

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    vx: np.ndarray
    vy: np.ndarray


class Shape(NamedTuple):
    radius: np.ndarray
    half_width: np.ndarray
    half_height: np.ndarray
    bound: np.ndarray


class Entity(NamedTuple):
    alive: np.ndarray


class Solid(NamedTuple):
    may_collide: np.ndarray
    max_travel: np.ndarray


class Weighed(NamedTuple):
    mass: np.ndarray


class Push(NamedTuple):
    x: np.ndarray
    y: np.ndarray


@kernel
def _cull(
    half_extents: Any, lines: Any, body: Any, shape: Any, entities: Any, members: Any, ray: Any, found: Any
) -> int:
    """found: int32 (3, blocks): bitsets of what `ray` may hit, what may be within its last number, what is alive."""
    aabbs, count = aabb.compute_aabbs(half_extents, body, shape), blocks.nonempty_blocks(lines, entities, members)
    for k in range(count):
        b = lines[blocks.BLOCK, k]
        found[0, b] = lines[blocks.BITS, k] & aabb.aabbs_hit_by_ray(aabbs, b, ray[0], ray[1], ray[2], ray[3])
        found[1, b] = lines[blocks.BITS, k] & aabb.aabbs_near_point(aabbs, b, ray[0], ray[1], ray[4])
        found[2, b] = lines[blocks.BITS, k]
    return count


@kernel
def _gaps(
    half_extents: Any, body: Any, shape: Any, solid: Any, entities: Any, members: Any, most: Any, out: Any
) -> None:
    """out: f4 (1 + rows, rows): clearances of all, then gaps of each from each."""
    aabbs = aabb.compute_aabbs(half_extents, body, shape)
    for e in range(out.shape[1]):
        out[0, e] = broad_phase.clearance(aabbs, body, shape, solid, entities, members, most, e)
        for o in range(out.shape[1]):
            out[1 + e, o] = broad_phase.gap(body, shape, e, o)


def _column(values: Any) -> np.ndarray:
    column = np.full(ROWS + SIMD_WIDTH, np.nan, F4)  # what is behind the end means nothing
    column[:ROWS] = values
    return column[:ROWS]


def random_bodies(seed: int, grid: bool) -> tuple[Body, Shape, Entity]:
    """Discs, rectangles, slivers and walls; on a grid many stand at the same place and touch to the bit."""
    rng = np.random.default_rng(seed)
    place = rng.integers(-6, 7, (2, ROWS)) / 2 if grid else rng.uniform(-12, 12, (2, ROWS))
    angle = rng.choice([0, 0.5, 1, 1.5], ROWS) * math.pi if grid else rng.uniform(-4, 4, ROWS)
    round_ = rng.random(ROWS) < 0.5
    half = np.where(
        round_, 0, rng.choice([0.0015, 0.05, 0.5, 1.5, 12.5] if grid else rng.uniform(0.002, 4, 9), (2, ROWS))
    )
    radius = np.where(round_, rng.choice([0.001, 0.25, 0.5, 3.0], ROWS), 0)
    speed = rng.normal(0, 3, (2, ROWS))
    body = Body(*map(_column, (*place, angle, np.cos(angle), np.sin(angle), *speed)))
    bound = np.maximum(radius, np.hypot(*half)).astype(F4) * F4(1 + 1e-6)
    alive = np.zeros(ROWS + SIMD_WIDTH, np.uint8)
    alive[:ROWS] = rng.random(ROWS) < 0.7
    return body, Shape(*map(_column, (radius, *half, bound))), Entity(alive[:ROWS])


def to_bits(rows: list[int]) -> np.ndarray:
    words = np.zeros(BLOCKS, np.int32)
    for e in rows:
        words[e // SIMD_WIDTH] |= 1 << e % SIMD_WIDTH
    return words


def listed(words: np.ndarray) -> list[int]:
    """The rows of bitsets, by the kernels that iterate over them."""
    found = []
    for b, word in enumerate(words.tolist()):
        while word:
            found.append(int(blocks.first_row(b, word)))
            word = int(blocks.without_row(word, b, found[-1]))
    return found


def entry(body: Body, shape: Shape, e: int, ray: Any) -> float:
    """Where the ray enters row `e`, in float64, by another formula."""
    x, y, dx, dy, _ = map(float, ray)
    if shape.radius[e] > 0:
        return naive.ray_circle((x, y), (dx, dy), (float(body.x[e]), float(body.y[e])), float(shape.radius[e]))
    place, angle = (float(body.x[e]), float(body.y[e])), math.atan2(float(body.sine[e]), float(body.cosine[e]))
    return naive.ray_box((x, y), (dx, dy), place, angle, float(shape.half_width[e]), float(shape.half_height[e]))


def surface(body: Body, shape: Shape, e: int, x: float, y: float) -> float:
    """How far the point is from the surface of row `e`; negative inside."""
    place = float(body.x[e]), float(body.y[e])
    if shape.radius[e] > 0:
        return math.dist(place, (x, y)) - float(shape.radius[e])
    angle, half = math.atan2(float(body.sine[e]), float(body.cosine[e])), (shape.half_width[e], shape.half_height[e])
    return naive.gap_circle_box((x, y), 0.0, place, angle, *map(float, half))


def apart(body: Body, shape: Shape, e: int, ray: Any) -> tuple[bool, bool]:
    """Of the upright rectangle around row `e`, a little enlarged: whether a line along x, y or the ray parts them.

    And whether it is further than `ray`'s last number from its beginning, along x or y.
    """
    x, y, dx, dy, reach = map(float, ray)
    x, y = float(body.x[e]) - x, float(body.y[e]) - y
    cosine, sine = abs(float(body.cosine[e])), abs(float(body.sine[e]))
    half = shape.half_width[e], shape.half_height[e]
    extra = float(shape.radius[e]) + 2e-3
    wide, tall = cosine * half[0] + sine * half[1] + extra, sine * half[0] + cosine * half[1] + extra
    beyond = x - wide > max(dx, 0) or x + wide < min(dx, 0) or y - tall > max(dy, 0) or y + tall < min(dy, 0)
    beside = abs(x * dy - y * dx) > wide * abs(dy) + tall * abs(dx) + 1e-5
    return beyond or beside, abs(x) > wide + reach or abs(y) > tall + reach


seeds, grids = st.integers(0, 2**32), st.booleans()
rays = st.tuples(
    *[st.integers(-6, 6).map(lambda k: k / 2) | st.floats(-6, 6, width=32)] * 4, st.sampled_from([0, 0.5, 2])
)


@SOME
@given(seeds, grids, rays)
def test_culling_keeps_all_that_is_hit_or_near(seed: int, grid: bool, ray: tuple[float, ...]) -> None:
    body, shape, entities = random_bodies(seed, grid)
    members = [e for e in range(ROWS) if e % 7]
    half_extents, lines = aabb.make_half_extents({"blocks": BLOCKS}), blocks.make_blocks({"blocks": BLOCKS})
    found = np.zeros((3, BLOCKS), np.int32)
    given_ray = np.array(ray, F4)
    count = _cull(half_extents, lines, body, shape, entities, to_bits(members), given_ray, found)
    living = [e for e in members if entities.alive[e]]
    assert listed(found[2]) == living
    assert count == len({e // SIMD_WIDTH for e in living})
    crossed, near = set(listed(found[0])), set(listed(found[1]))
    assert crossed | near <= set(living)
    for e in living:
        assert e in crossed or entry(body, shape, e, given_ray) == naive.NO_HIT
        assert e in near or surface(body, shape, e, float(given_ray[0]), float(given_ray[1])) > float(given_ray[4])
    for e in crossed | near:  # and few others
        parted, far = apart(body, shape, e, given_ray)
        assert e not in crossed or not parted
        assert e not in near or not far


@kernel
def _near(index: Any, half_extents: Any, body: Any, shape: Any, entities: Any, members: Any, box: Any) -> int:
    count = blocks.nonempty_blocks(index[0], entities, members)
    spatial_index.build(index, count, aabb.compute_aabbs(half_extents, body, shape))
    return spatial_index.query(index, count, box[0], box[2], box[1], box[3])


@SOME
@given(seeds, grids, st.sampled_from([0.0, 70.0, 9e4]), rays, st.integers(2, 7))
def test_the_index_keeps_all_that_reach_into_a_rectangle(
    seed: int, grid: bool, away: float, ends: tuple[float, ...], spread: int
) -> None:
    """And leaves out all that are a step away. The room may be far from (0, 0), some of its blocks empty."""
    body, shape, entities = random_bodies(seed, grid)
    body = body._replace(x=_column(body.x + F4(away)))
    members = [e for e in range(ROWS) if e % spread and entities.alive[e]]
    dims = {"blocks": BLOCKS}
    index = tuple(spatial_index.make_scratch(name, dims) for name in ("blocks", "sides", "scale", "words", "rows"))
    for scratch in index:
        scratch[:] = 1  # what is left from another world
    box = np.array([*np.minimum(ends[:2], ends[2:4]), *np.maximum(ends[:2], ends[2:4])], F4)
    box[::2] += F4(away)
    half_extents = aabb.make_half_extents(dims)
    with np.errstate(over="ignore"):  # the last of 64 rows is the sign of a bitset
        found = index[spatial_index.ROWS][
            : _near(index, half_extents, body, shape, entities, to_bits(members), box)
        ].tolist()
    assert found == sorted({*found} & {*members})
    overlapping, apart = np.ones(ROWS, bool), np.zeros(ROWS, bool)
    for axis, centres in enumerate((body.x, body.y)):
        first, per_metre = index[2][axis].astype(float)
        sides = [centres - half_extents[axis, :ROWS].astype(float), centres + half_extents[axis, :ROWS].astype(float)]
        overlapping &= (sides[0] <= box[2 + axis]) & (sides[1] >= box[axis])
        steps = [np.clip((side - first) * per_metre, 0, 254) for side in (*sides, box[axis], box[2 + axis])]
        rounding = 1.01 + per_metre * 1e-6 * 3 * (abs(first) + 254 / per_metre)
        apart |= (steps[0] > steps[3] + rounding) | (steps[1] < steps[2] - rounding)
    assert {e for e in members if overlapping[e]} <= {*found}
    assert not any(apart[e] for e in found)


def test_arrays_that_kernels_return_are_counted() -> None:
    """A function that hands out a view of an array without counting it has it freed while it is in use."""
    body, shape, entities = random_bodies(0, grid=False)
    half_extents, lines = aabb.make_half_extents({"blocks": BLOCKS}), blocks.make_blocks({"blocks": BLOCKS})
    ray, found = np.zeros(5, F4), np.zeros((3, BLOCKS), np.int32)
    arrays = [*body, *shape, *entities, half_extents, lines, found]
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(9):
        _cull(half_extents, lines, body, shape, entities, to_bits([0, 1]), ray, found)
    assert [sys.getrefcount(array) for array in arrays] == before


@SOME
@given(seeds, grids)
def test_gaps_are_never_more_than_the_way_between_surfaces(seed: int, grid: bool) -> None:
    """From the circle around one body to the surface of another, and so at most the way between them."""
    body, shape, entities = random_bodies(seed, grid)
    solid = Solid((np.arange(ROWS) % 3 == 0).astype(np.uint8), _column(np.arange(ROWS) % 5 * 0.1))
    near = np.zeros(ROWS + SIMD_WIDTH, np.uint8)
    near[:ROWS] = solid.may_collide
    out, most = np.zeros((1 + ROWS, ROWS), F4), F4(4)
    half_extents = aabb.make_half_extents({"blocks": BLOCKS})
    _gaps(
        half_extents, body, shape, solid._replace(may_collide=near[:ROWS]), entities, to_bits([*range(ROWS)]), most, out
    )
    for e in range(0, ROWS, 5):
        centre, others = (float(body.x[e]), float(body.y[e])), [o for o in range(ROWS) if entities.alive[o]]
        for o in others:
            exact = surface(body, shape, o, *centre) - float(shape.bound[e])
            gap = float(out[1 + e, o])
            assert gap <= exact + SLACK
            assert gap >= exact - SLACK or surface(body, shape, o, *centre) > 0  # a corner's distance is exact, too
        free = [float(out[1 + e, o]) - float(solid.max_travel[o]) for o in others if not solid.may_collide[o]]
        assert float(out[0, e]) == pytest.approx(max(0.0, min([float(most), *free])), abs=SLACK)


@SOME
@given(st.tuples(*[st.floats(-30, 30, width=32)] * 4), st.sampled_from([0.0, 0.785, 1e3, 0.0033]), st.floats(0.01, 0.1))
def test_travel_is_never_less_than_the_way_of_a_push(motion: tuple[float, ...], mass: float, time: float) -> None:
    """A bound on speed, whichever way the push goes."""
    vx, vy, jx, jy = motion
    body = Body(*(np.array([value], F4) for value in (0, 0, 0, 1, 0, vx, vy)))
    push, inverse_mass = Push(*(np.array([value], F4) for value in (jx, jy))), 1 / mass if mass else 0.0
    bound = float(broad_phase.travel(body, push, Weighed(np.array([mass], F4)), 0, F4(time)))
    exact = [
        math.hypot(vx + sign * inverse_mass * jx, vy + other * inverse_mass * jy)
        for sign in (1, -1)
        for other in (1, -1)
    ]
    assert bound >= max(exact) * float(F4(time)) * (1 - 1e-5) - 1e-18  # squares of less vanish in float32
    assert bound == pytest.approx(max(exact) * time, rel=1e-4, abs=1e-6)


def test_the_span_of_a_bitset_holds_its_blocks() -> None:
    for rows, expected in (([], (BLOCKS, 0)), ([0], (0, 1)), ([20], (1, 2)), ([20, ROWS - 1], (1, BLOCKS))):
        assert tuple(blocks.block_span(to_bits(rows))) == expected
    assert NO_HIT > 1
