"""Rays, cones and gaps against pybox2d (bit for bit where it can be) and against naive plain-Python forms."""

import math
import platform
from collections.abc import Iterator
from typing import Any, NamedTuple

import Box2D
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from outlast.ecs import kernel
from outlast.systems.geometry import plans
from outlast.systems.geometry.points import gap_circle_box, in_kite, in_sector
from outlast.systems.geometry.rays import NO_HIT, ray_box, ray_circle
from tests.helpers import naive_geometry as naive

COUNT = 10_000 if numba.config.DISABLE_JIT else 50_000
TOLERANCE = 1e-5
# Elsewhere either compiler may fuse multiply and add; then only the tolerance holds.
SAME_BITS = platform.machine() in ("x86_64", "AMD64")
F4 = np.float32
QUICK = settings(max_examples=100 if numba.config.DISABLE_JIT else 400, deadline=None, derandomize=True)


@pytest.fixture(autouse=True, scope="module")
def _overflow() -> Iterator[None]:
    """Uncompiled, a division by a tiny direction may overflow to infinity, which the kernels handle."""
    with np.errstate(over="ignore"):
        yield


class Queries(NamedTuple):
    """Rays and bodies, one a row. origin, ray, centre, half: f4[n, 2]; angle, cosine, sine: f4[n]."""

    origin: np.ndarray
    ray: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    angle: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray


@kernel
def _cast_circles(queries: Queries, out: np.ndarray) -> None:
    for i in range(len(out)):
        o, d, c = queries.origin[i], queries.ray[i], queries.centre[i]
        out[i] = ray_circle(o[0], o[1], d[0], d[1], c[0], c[1], queries.half[i, 0])


@kernel
def _cast_boxes(queries: Queries, out: np.ndarray) -> None:
    for i in range(len(out)):
        o, d, c, half = queries.origin[i], queries.ray[i], queries.centre[i], queries.half[i]
        cosine, sine = queries.cosine[i], queries.sine[i]
        out[i] = ray_box(o[0], o[1], d[0], d[1], c[0], c[1], cosine, sine, half[0], half[1])


def _queries(seed: int, count: int) -> Queries:
    """Rays of game lengths with a body near most of them; some rays start inside, some stop short."""
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-12.5, 12.5, (count, 2))
    heading = rng.uniform(-np.pi, np.pi, count)
    length = rng.choice([0.01, 0.5, 2, 10, 30], count)
    ray = np.stack([np.cos(heading), np.sin(heading)], 1) * length[:, None]
    centre = origin + ray * rng.uniform(-0.2, 1.3, count)[:, None] + rng.normal(0, 0.8, (count, 2))
    half = rng.uniform(0.05, 2, (count, 2))
    half[::10, 1] = 12.5  # walls
    angle = rng.uniform(-np.pi, np.pi, count) * rng.choice([0, 1], count, p=[0.1, 0.9])
    return _pack(origin, ray, centre, half, angle)


def _pack(*arrays: np.ndarray) -> Queries:
    """Queries of the columns up to angle, rounded to float32, with cosine and sine as Box2D takes them."""
    columns = [np.ascontiguousarray(array, F4) for array in arrays]
    turns = np.array([_turn(value) for value in columns[4].tolist()], F4)
    return Queries(*columns, np.ascontiguousarray(turns[:, 0]), np.ascontiguousarray(turns[:, 1]))


def _turn(angle: float) -> tuple[float, float]:
    transform = Box2D.b2Transform()
    transform.Set((0, 0), angle)
    return transform.q.c, transform.q.s


def _box2d_casts(queries: Queries, circles: bool) -> np.ndarray:
    """Fractions by b2Shape::RayCast itself, the call behind fixture and world casts."""
    shape = Box2D.b2CircleShape() if circles else Box2D.b2PolygonShape(box=(1, 1))
    transform, result = Box2D.b2Transform(), Box2D.b2RayCastOutput()
    segment = Box2D.b2RayCastInput(p1=(0, 0), p2=(0, 0), maxFraction=1)
    ends = (queries.origin + queries.ray).tolist()
    out = np.full(len(ends), NO_HIT)
    starts, centres, angles, halves = (queries[column].tolist() for column in (0, 2, 4, 3))
    rows = zip(starts, ends, centres, angles, halves, strict=True)
    for i, (segment.p1, segment.p2, centre, angle, half) in enumerate(rows):
        transform.Set(centre, angle)
        if circles:
            shape.radius = half[0]
        else:
            shape.box = half
        if shape.RayCast(result, segment, transform, 0):
            out[i] = result.fraction
    return out


def _cast(queries: Queries, circles: bool) -> np.ndarray:
    out = np.empty(len(queries.origin), F4)
    (_cast_circles if circles else _cast_boxes)(queries, out)
    return out


def _agree(queries: Queries, circles: bool) -> np.ndarray:
    """Assert that kernel and Box2D agree on every row; the fractions."""
    ours, theirs = _cast(queries, circles), _box2d_casts(queries, circles)
    if SAME_BITS:
        np.testing.assert_array_equal(ours, theirs)
    grown = _cast(queries._replace(half=queries.half + F4(TOLERANCE)), circles)
    shrunk = _cast(queries._replace(half=queries.half - F4(TOLERANCE)), circles)
    clear = (grown < 1) & (shrunk < 1) | (grown > 1) & (shrunk > 1)  # not within the tolerance of hit or miss
    np.testing.assert_allclose(ours[clear], theirs[clear], rtol=0, atol=TOLERANCE)
    assert clear.mean() > 0.9
    return ours


@pytest.mark.parametrize("circles", [True, False], ids=["circles", "boxes"])
@pytest.mark.by_day(1)
def test_rays_equal_box2d(circles: bool) -> None:
    fractions = _agree(_queries(1, COUNT), circles)
    hits = fractions <= 1
    assert 0.2 < hits.mean() < 0.5
    assert (fractions[~hits] == NO_HIT).all()


@pytest.mark.parametrize("circles", [True, False], ids=["circles", "boxes"])
def test_rays_equal_box2d_where_everything_touches(circles: bool) -> None:
    grid = np.arange(-3, 4)
    rows = np.stack(np.meshgrid(grid, grid, grid, grid, [1, 2], [1, 2], indexing="ij"), -1).reshape(-1, 6)
    rows = rows[:: 3 if numba.config.DISABLE_JIT else 1]
    zeros = np.zeros(len(rows))
    queries = _pack(rows[:, :2], rows[:, 2:4], np.zeros((len(rows), 2)), rows[:, 4:], zeros)
    np.testing.assert_array_equal(_cast(queries, circles), _box2d_casts(queries, circles))


def _f4(*numbers: float) -> list[np.float32]:
    return [F4(number) for number in numbers]


def test_nearly_parallel_rays_do_not_break() -> None:
    for tiny in (1e-45, 1e-38, 1e-20):
        for sign in (1, -1):
            ray = _f4(-4, 0.5, 8, sign * tiny)
            assert float(ray_box(*ray, *_f4(0, 0, 1, 0, 2, 1))) == 0.25
            assert float(ray_circle(*ray, *_f4(0, 0, 1))) <= 1


coordinate = st.floats(-12.5, 12.5, width=32)
size = st.floats(0.25, 2, width=32)
turned = st.floats(-math.pi, math.pi)
pair = st.tuples(coordinate, coordinate)


@QUICK
@given(pair, pair, turned, st.floats(1, 12), st.floats(0.1, 3))
def test_cameras_equal_the_naive_form(
    p: naive.Point, o: naive.Point, heading: float, depth: float, half_fov: float
) -> None:
    numbers = (*p, *o, math.cos(heading), math.sin(heading), depth, math.cos(half_fov), math.sin(half_fov))
    corners = naive.kite_corners(o, heading, depth, half_fov)
    if naive.edge_distance(p, corners) > TOLERANCE:
        assert in_kite(*_f4(*numbers)) == naive.in_kite(p, o, heading, depth, half_fov)
    sides = [corners[1], corners[0], corners[3]]
    if naive.edge_distance(p, sides) > TOLERANCE and abs(math.dist(p, o) - depth) > TOLERANCE:
        assert in_sector(*_f4(*numbers)) == naive.in_sector(p, o, heading, depth, half_fov)


@QUICK
@given(pair, size, pair, turned, size, size)
def test_gap_equals_the_naive_form(
    centre: naive.Point, radius: float, box: naive.Point, angle: float, width: float, height: float
) -> None:
    numbers = (*centre, radius, *box, math.cos(angle), math.sin(angle), width, height)
    expected = naive.gap_circle_box(centre, radius, box, angle, width, height)
    assert float(gap_circle_box(*_f4(*numbers))) == pytest.approx(expected, abs=TOLERANCE)


rectangle = st.tuples(*[st.floats(-5, 5)] * 2, st.floats(0.25, 9), st.floats(0.25, 9), turned, st.just(99.0))


def _corners(x: float, y: float, width: float, height: float, angle: float, _: float) -> list[naive.Point]:
    return naive.box_corners((x, y), angle, width / 2, height / 2)


def _overlap(one: Any, two: Any, wider: float) -> bool:
    """Whether one, made wider and higher, has a corner of the other, or crosses one of its sides."""
    corners, others = _corners(*one[:2], one[2] + wider, one[3] + wider, *one[4:]), _corners(*two)
    sides = [(a, (b[0] - a[0], b[1] - a[1])) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    crossing = any(naive.ray_polygon(*side, others) < NO_HIT for side in sides)
    return crossing or naive.in_polygon(corners[0], others) or naive.in_polygon(others[0], corners)


@QUICK
@given(rectangle, rectangle, st.floats(0, 2))
def test_rectangles_of_plans_equal_the_naive_form(one: Any, two: Any, radius: float) -> None:
    """Where sides coincide, rounding decides; points are free if a disc has room."""
    if (expected := _overlap(one, two, -TOLERANCE)) == _overlap(one, two, TOLERANCE):
        assert plans.overlap(one, two) == plans.overlap(two, one) == expected
    corners = _corners(*one)
    assert plans.reach(one) == pytest.approx(abs(np.array(corners)).max(0))
    xs, ys = plans.lattice(one, 3)
    start, along, across = np.array(corners[0]), *np.subtract(corners[1::2], corners[0])
    points = [start + along * (column + 0.5) / 3 + across * (row + 0.5) / 3 for row in range(3) for column in range(3)]
    np.testing.assert_allclose(np.stack([xs, ys], -1).reshape(-1, 2), points, atol=1e-9)
    free = plans.are_free(xs, ys, [two], (20, 15), radius)
    for (x, y), each in zip(points, free.ravel(), strict=True):
        gap = naive.gap_circle_box((x, y), radius, two[:2], two[4], two[2] / 2, two[3] / 2)
        margins = gap, 10 - radius - abs(x), 7.5 - radius - abs(y)
        assert min(map(abs, margins)) < TOLERANCE or each == (min(margins) > 0)


def test_rectangles_that_touch_do_not_overlap_and_discs_that_touch_blocks_are_not_free() -> None:
    """A corner of a square is at the middle of a side; only the axis across that side separates them."""
    for angle in np.linspace(0, 3, 20):
        for turn, half in (0, 2), (math.pi / 2, 0.5):
            for far, overlapping in (1e-8, False), (-1e-5, True):
                place = (half + math.sqrt(2) + far) * np.exp(1j * (angle + turn))
                pair = (0, 0, 4, 1, angle), (place.real, place.imag, 2, 2, angle + math.pi / 4)
                assert plans.overlap(*pair) == plans.overlap(*pair[::-1]) == overlapping
    assert plans.are_free(np.array([0.5, -0.5]), np.array([1, -1]), [(3, 1, 1, 9, 0)], (3, 4), 1).all()
    assert not plans.are_free(np.array([0]), np.array([0]), [(2, 0, 2, 2, 0)], (9, 9), 1)


def test_parts_of_a_lattice_are_those_of_a_flood_fill() -> None:
    rng = np.random.default_rng(0)
    for share in (0, 1, *rng.uniform(0.2, 0.7, 40)):
        free = rng.random(rng.integers(1, 20, 2)) < share
        parts = np.zeros(np.add(free.shape, 2), int)
        for start in np.argwhere(free) + 1:
            pending, number = [tuple(start)], parts.max() + 1
            while pending:
                i, j = pending.pop()
                if free[i - 1 : i, j - 1 : j].any() and not parts[i, j]:
                    parts[i, j] = number
                    pending += [(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        np.testing.assert_array_equal(plans.connected(free), parts[1:-1, 1:-1])
