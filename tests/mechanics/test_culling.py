"""Culling by AABBs, and the broad phase: nothing is culled that is hit, seen or touched."""

import itertools
import math
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outlast.ecs import kernel
from outlast.ecs.kernels.simd import LARGEST, SIMD_WIDTH
from outlast.systems.geometry import bodies, broad_phase
from tests.conftest import COMPILED
from tests.helpers import naive_geometry as naive

BLOCKS, MANY = 5, 13  # MANY are more than bodies.FEW
ROWS = BLOCKS * SIMD_WIDTH - 5  # the last block is not full
F4 = np.float32
SLACK = 2e-4  # metres: what float32 may lose in a sum of a few numbers of a room's size
SOME = settings(max_examples=80 if COMPILED else 15, deadline=None, derandomize=True)


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
    mass: np.ndarray


@kernel
def _ask(index: Any, members: Any, ray: Any, found: Any) -> None:
    """found: int32 (3, 1 + rows): how many rows `ray` may hit, are near its start, are in its rectangle; the rows."""
    x, y, dx, dy, distance = ray[0], ray[1], ray[2], ray[3], ray[4]
    for query in range(3):
        if query == 0:
            count = bodies.on_ray(index, members, x, y, dx, dy)
        elif query == 1:
            count = bodies.near(index, members, x, y, distance)
        else:
            count = bodies.in_box(index, members, min(x, x + dx), max(x, x + dx), min(y, y + dy), max(y, y + dy))
        found[query, 0] = count
        for k in range(count):
            found[query, 1 + k] = index.rows[k]


@kernel
def _gaps(index: Any, body: Any, shape: Any, solid: Any, entities: Any, members: Any, most: Any, out: Any) -> None:
    """out: f4 (1 + rows, rows): clearances of all, then gaps of each from each."""
    bodies.refresh(index)
    aabbs = index.body.x, index.body.y, index.half_extents[0], index.half_extents[1]
    for e in range(out.shape[1]):
        out[0, e] = broad_phase.clearance(aabbs, body, shape, solid, entities, members, most, e)
        for o in range(out.shape[1]):
            out[1 + e, o] = broad_phase.gap(body, shape, e, o)


def index_of(body: Any, shape: Any, entities: Any, members: np.ndarray) -> bodies.Index:
    index = bodies.make_index({"blocks": members.size})
    return index._replace(body=body, shape=shape, entities=entities, members=members)


def _column(values: Any) -> np.ndarray:
    column = np.full(len(values) + SIMD_WIDTH, np.nan, F4)  # what is behind the end means nothing
    column[: len(values)] = values
    return column[: len(values)]


def random_bodies(seed: int, grid: bool, rows: int = ROWS) -> tuple[Body, Shape, Entity]:
    """Discs, rectangles, slivers and walls; on a grid many stand at the same place and touch to the bit."""
    rng = np.random.default_rng(seed)
    place = rng.integers(-6, 7, (2, rows)) / 2 if grid else rng.uniform(-12, 12, (2, rows))
    angle = rng.choice([0, 0.5, 1, 1.5], rows) * math.pi if grid else rng.uniform(-4, 4, rows)
    round_ = rng.random(rows) < 0.5
    half = np.where(
        round_, 0, rng.choice([0.0015, 0.05, 0.5, 1.5, 12.5] if grid else rng.uniform(0.002, 4, 9), (2, rows))
    )
    radius = np.where(round_, rng.choice([0.001, 0.25, 0.5, 3.0], rows), 0)
    speed = rng.normal(0, 3, (2, rows))
    body = Body(*map(_column, (*place, angle, np.cos(angle), np.sin(angle), *speed)))
    bound = np.maximum(radius, np.hypot(*half)).astype(F4) * F4(1 + 1e-6)
    alive = np.zeros(rows + SIMD_WIDTH, np.uint8)
    alive[:rows] = rng.random(rows) < 0.7
    return body, Shape(*map(_column, (radius, *half, bound))), Entity(alive[:rows])


def to_bits(rows: list[int], blocks: int = BLOCKS) -> np.ndarray:
    words = np.zeros(blocks, np.int32)
    for e in rows:
        words[e // SIMD_WIDTH] |= 1 << e % SIMD_WIDTH
    return words


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


seeds, grids = st.integers(0, 2**32), st.booleans()
rays = st.tuples(
    *[st.integers(-6, 6).map(lambda k: k / 2) | st.floats(-6, 6, width=32)] * 4, st.sampled_from([0, 0.5, 2])
)


@SOME
@given(seeds, grids, rays, st.integers(0, MANY), st.sampled_from([0.0, 70.0, 9e4]), st.integers(2, 7))
def test_queries_list_all_that_is_hit_or_near(
    seed: int, grid: bool, ray: tuple[float, ...], blocks: int, away: float, spread: int
) -> None:
    """In order; bodies live in all rooms from an empty one to a crowd, which may be far from (0, 0)."""
    away *= blocks > bodies.FEW  # elsewhere, the exact tests are right to millimetres only
    rows = MANY * SIMD_WIDTH - 5
    body, shape, entities = random_bodies(seed, grid, rows)
    body = body._replace(x=_column(body.x + F4(away)))
    entities.alive[SIMD_WIDTH * blocks :] = 0
    with_shape, members = [e for e in range(rows) if e % 11], [e for e in range(rows) if e % spread]
    index = index_of(body, shape, entities, to_bits(with_shape, MANY))
    for memory in index[: index._fields.index("body")]:
        memory[:] = 1  # what is left from another world
    index.count[0] = bodies.STALE
    given_ray, found = np.array(ray, F4), np.zeros((3, 1 + rows), np.int32)
    given_ray[0] += F4(away)
    with np.errstate(over="ignore"):  # the last of 64 rows is the sign of a bitset
        _ask(index, to_bits(members, MANY), given_ray, found)
    living = [e for e in with_shape if entities.alive[e]]
    assert index.living.tolist() == to_bits(living, MANY).tolist()
    assert index.lines[: index.count[0]].tolist() == sorted({e // SIMD_WIDTH for e in living})
    wanted = {*members} & {*living}
    crossed, near, boxed = (found[k, 1 : 1 + found[k, 0]].tolist() for k in range(3))
    for listed in (crossed, near, boxed):
        assert listed == sorted({*listed} & wanted)
    x, y, dx, dy, far = map(float, given_ray)
    for e in wanted if not away else ():
        assert e in crossed or entry(body, shape, e, given_ray) == naive.NO_HIT
        assert e in near or surface(body, shape, e, x, y) > far
    boxes = overlaps(rectangles(index, rows), ends(x, dx), ends(y, dy))
    assert {e for e in wanted if boxes[e]} <= {*boxed}
    if index.count[0] > bodies.FEW:  # the sides are rounded outwards, and by more than float32 loses
        listed = (SIMD_WIDTH * index.lines[: index.count[0], None] + np.arange(SIMD_WIDTH)).ravel()
        there = np.isin(listed, living)
        sides, half_ulp = rectangles(index, rows)[:, :, listed[there]], 2.0**-24
        for axis, (start, steps) in enumerate(index.scale.tolist()):
            low, high = ((sides[axis] + [[-half_ulp], [half_ulp]] * abs(sides[axis]) - start) * steps).clip(0, LARGEST)
            got = index.sides[2 * axis : 2 * axis + 2, : listed.size][:, there]
            assert (got[0] <= low).all()
            assert (got[1] >= np.floor(high)).all()


def ends(start: float, length: float) -> tuple[float, float]:
    """Both ends of a range in float32, as kernels get them."""
    other = float(F4(F4(start) + F4(length)))
    return min(start, other), max(start, other)


def rectangles(index: bodies.Index, rows: int) -> np.ndarray:
    """AABBs of all rows, (axis, low or high, row)."""
    centres = np.stack([index.body.x, index.body.y]).astype(float)
    halves = index.half_extents[:, :rows].astype(float)
    return np.stack([centres - halves, centres + halves], 1)


def overlaps(sides: np.ndarray, *box: tuple[float, float]) -> np.ndarray:
    low, high = np.array(box).T[:, :, None]
    return ((sides[:, 0] <= high) & (sides[:, 1] >= low)).all(0)


def test_arrays_that_kernels_return_are_counted() -> None:
    """A function that hands out a view of an array without counting it has it freed while it is in use."""
    body, shape, entities = random_bodies(0, grid=False)
    found, members, ray = np.zeros((3, 1 + ROWS), np.int32), to_bits([0, 1]), np.zeros(5, F4)
    index = index_of(body, shape, entities, members)
    arrays = [*body, *shape, *entities, *index[:-4], found, members]
    before = [sys.getrefcount(array) for array in arrays]
    for _ in range(9):
        index.count[0] = bodies.STALE
        _ask(index, members, ray, found)
    assert [sys.getrefcount(array) for array in arrays] == before


@SOME
@given(seeds, grids)
def test_gaps_are_never_more_than_the_way_between_surfaces(seed: int, grid: bool) -> None:
    """From the circle around one body to the surface of another, and so at most the way between them."""
    body, shape, entities = random_bodies(seed, grid)
    number = np.arange(ROWS)
    solid = Solid((number % 3 == 0).astype(np.uint8), _column(number % 5 * 0.1), _column(number))
    near = np.zeros(ROWS + SIMD_WIDTH, np.uint8)
    near[:ROWS] = solid.may_collide
    out, most = np.zeros((1 + ROWS, ROWS), F4), F4(4)
    members = to_bits([*range(ROWS)])
    index = index_of(body, shape, entities, members)
    _gaps(index, body, shape, solid._replace(may_collide=near[:ROWS]), entities, members, most, out)
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
def test_travel_is_the_longest_way_of_a_push_in_any_direction(
    motion: tuple[float, ...], mass: float, time: float
) -> None:
    vx, vy, jx, jy = (np.array([value], F4) for value in motion)
    body, solid, each = Body(vx, vx, vx, vx, vx, vx, vy), Solid(vx, vx, np.array([mass], F4)), 1 / mass if mass else 0.0
    bound = float(broad_phase.travel(body, body._replace(x=jx, y=jy), solid, 0, F4(time)))
    signs = itertools.product((each, -each), repeat=2)
    longest = max(math.hypot(motion[0] + a * motion[2], motion[1] + b * motion[3]) for a, b in signs)
    assert bound >= longest * float(F4(time)) * (1 - 1e-5) - 1e-18  # squares of less vanish in float32
    assert bound == pytest.approx(longest * time, rel=1e-4, abs=1e-6)
