"""Convex polygons: both backends agree to the bit, masses are Box2D's, and what cannot be is refused in a sentence."""

import ctypes
import math
from typing import Any

import Box2D
import numpy as np
import pytest

from outlast.components import Body, Polygon, Push, Shape, Solid
from outlast.ecs import RESET, Archetype, DeclarationError, Module, Worlds
from outlast.systems import Physics
from outlast.systems.box2d import layout, native, outline, portable
from tests.conftest import scaled
from tests.physics.test_box2d import SETTINGS, backends, boxes, circles, needs_native, random_batch
from tests.physics.test_joints import random_joints
from tests.physics.test_traits import random_traits

from outlast.systems.box2d.batch import (  # isort: skip
    ABANDONED, CORNER, CORNERS, DYNAMIC, HALF_HEIGHT, HALF_WIDTH, INVALID, MAX_TRAVEL, OUTLINE, RADIUS, SOLVED, TOUCHES,
    VX, X, ContactBatch,
)  # fmt: skip

Matrix = np.ndarray[Any, Any]
WEDGE = [(0, 0), (2, 0), (0, 1)]
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]


def random_polygon(rng: np.random.Generator) -> Polygon:
    """Three to eight corners on an ellipse of 10 cm to 3 m, which is turned by any angle."""
    while True:
        angles, turn = np.sort(rng.uniform(0, 2 * math.pi, rng.integers(3, 9))), rng.uniform(0, 2 * math.pi)
        points = (rng.uniform(0.05, 1.5) * np.cos(angles) + 1j * rng.uniform(0.05, 1.5) * np.sin(angles)) * np.exp(
            1j * turn
        )
        try:
            return Polygon([(point.real, point.imag) for point in points])
        except DeclarationError:
            continue  # corners too near to each other


def outline_of(polygon: Polygon) -> Matrix:
    row, fills = np.zeros(OUTLINE, np.float32), polygon.fills
    row[CORNERS], row[CORNER::2], row[CORNER + 1 :: 2] = fills["corners"], fills["x"], fills["y"]
    return row


def corners_of(polygon: Polygon) -> list[tuple[float, float]]:
    fills = polygon.fills
    return [(float(x), float(y)) for x, y in zip(fills["x"], fills["y"], strict=True)][: fills["corners"]]


def random_outlines(rng: np.random.Generator, batch: ContactBatch) -> Matrix:
    """Polygons in place of most rectangles of a batch."""
    outlines = np.zeros((len(batch), OUTLINE), np.float32)
    for k in np.flatnonzero((batch[:, RADIUS] == 0) & (rng.random(len(batch)) < 0.7)):
        become(batch, outlines, k, random_polygon(rng))
    return outlines


def become(batch: ContactBatch, outlines: Matrix, k: int, polygon: Polygon) -> None:
    outlines[k] = outline_of(polygon)
    batch[k, RADIUS], (shape,) = 0, polygon.brings()
    batch[k, HALF_WIDTH], batch[k, HALF_HEIGHT] = shape.fills["half_width"], shape.fills["half_height"]


def solved(backend: Any, memory: Any, batch: ContactBatch, joints: Any, *given: Any) -> Any:
    batch, joints = batch.copy(), joints.copy()
    traits, touches, outlines = given
    result = backend.solve(memory, SETTINGS, batch, len(batch), traits, joints, len(joints), touches, outlines)
    return result, batch, joints


@needs_native
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 20))])
def test_backends_agree_about_polygons(seed: int) -> None:
    """With joints, traits and touches, and without; fast ones fly as far as three metres in a substep."""
    rng, workspace, results = np.random.default_rng(seed), native.listen(native.make_workspace()), set()
    for k in range(500):
        batch = random_batch(rng)
        outlines, found = random_outlines(rng, batch), np.zeros((2, 50, TOUCHES), np.float32)
        joints, traits = random_joints(rng, len(batch))[: 99 * (k % 2)], random_traits(rng, batch) if k % 3 else None
        own = solved(native, workspace, batch, joints, traits, found[0] if k % 2 else None, outlines)
        other = solved(portable, None, batch, joints, traits, found[1] if k % 2 else None, outlines)
        assert own[0] == other[0]
        assert own[1].tobytes() == other[1].tobytes()
        if own[0] == SOLVED:
            np.testing.assert_array_equal(own[2], other[2])
            np.testing.assert_array_equal(*found)
        results.add(own[0])
        plain = (solved(backend, memory, batch, joints[:0], None, None, None)
                 for backend, memory in ((native, workspace), (portable, None)))  # fmt: skip
        assert len({each[1].tobytes() for each in plain}) == 1  # nothing of the polygons is left in the workspace
    assert results == {SOLVED, ABANDONED}


@needs_native
def test_a_polygon_is_written_as_box2d_sets_it() -> None:
    """Corners, normals, middle and number, to the bit, also after another one and before a box."""
    rng, memory = np.random.default_rng(1), Box2D.b2PolygonShape(box=(1, 1))
    box = ctypes.string_at(int(memory.this), layout.POLYGON_SIZE)
    for _ in range(200):
        polygon = random_polygon(rng)
        expected = Box2D.b2PolygonShape(vertices=corners_of(polygon))
        outline.write_polygon(int(memory.this), outline_of(polygon))
        assert memory.vertices == expected.vertices
        assert memory.normals == expected.normals
        assert (*memory.centroid,) == (*expected.centroid,)
        outline.restore_box(int(memory.this))
        (
            memory.set_vertex(0, -1, -1),
            memory.set_vertex(1, 1, -1),
            memory.set_vertex(2, 1, 1),
            memory.set_vertex(3, -1, 1),
        )
        after = ctypes.string_at(int(memory.this), layout.POLYGON_SIZE)
        for start, size in (layout.POLYGON_CENTROID, 8), (layout.POLYGON_NORMALS, 32), (layout.POLYGON_COUNT, 4):
            assert after[start : start + size] == box[start : start + size]


class Heap(Module):
    """A kind of many polygons."""

    def archetypes(self) -> list[Archetype]:
        rng = np.random.default_rng(2)
        self.polygons = [random_polygon(rng) for _ in range(scaled(300, 30))]
        density = rng.uniform(0.1, 5, len(self.polygons)).astype(np.float32)
        parts = Body(), Push(), Polygon([corners_of(each) for each in self.polygons]), Solid(density=density)
        return [Archetype("stone", parts, len(self.polygons))]


def test_mass_and_moment_of_inertia_are_those_of_box2d() -> None:
    made = Worlds((Heap(), Physics()), 1)
    made.run(np.full(1, RESET, np.int8))
    polygons, solid, world = made[Polygon], made[Solid], Box2D.b2World()
    for e in made.layout.rows(Polygon):
        points = [(float(x), float(y)) for x, y in zip(polygons.x[0, e], polygons.y[0, e], strict=True)]
        shape = Box2D.b2PolygonShape(vertices=points[: polygons.corners[0, e]])
        data = world.CreateStaticBody().CreateFixture(shape=shape, density=float(solid.density[0, e])).massData
        assert (solid.mass[0, e], solid.inertia[0, e]) == (np.float32(data.mass), np.float32(data.I))
        assert math.hypot(*data.center) < 1e-6


@pytest.mark.parametrize("turned", [False, True])
def test_corners_are_put_around_the_centre_of_mass_in_box2ds_order(turned: bool) -> None:
    polygon = Polygon([(x + 5, y - 7) for x, y in (WEDGE[::-1] if turned else WEDGE)])
    np.testing.assert_allclose(corners_of(polygon), [(4 / 3, -1 / 3), (-2 / 3, 2 / 3), (-2 / 3, -1 / 3)], atol=1e-6)
    (shape,) = polygon.brings()
    assert (float(shape.fills["half_width"]), float(shape.fills["half_height"])) == pytest.approx((4 / 3, 2 / 3))


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        ([(0, 0), (1, 0)], r"has 2 corners: 3 to 8 are possible; for more, weld several bodies"),
        ([(math.cos(k), math.sin(k)) for k in np.arange(9) * 0.69], "has 9 corners: 3 to 8"),
        ([(0, 0), (1, 0), (math.nan, 1)], r"corner 2 is \(nan, 1\); numbers up to 10000 metres"),
        ([(0, 0), (1, 0), (0, math.inf)], r"corner 2 is \(0, inf\)"),
        ([(0, 0), (1e5, 0), (0, 1)], r"corner 1 is \(100000, 0\)"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "corners 1 and 2 are less than 5 mm apart; leave one of them out"),
        ([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], "corners 4 and 0 are less than 5 mm apart"),
        ([(0, 0), (1, 0), (2, 0), (0, 1)], "corners 0, 1 and 2 are in line, within 5 mm; leave the middle one out"),
        ([(0, 0), (1, 0), (2, 0)], "in line"),
        ([(0, 0), (0.004, 0), (0, 0.004)], "less than 5 mm apart"),
        ([(0, 0), (2, 0), (0.5, 0.5), (0, 2)], "not convex: corner . is outside of the edge from corner . to corner ."),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "not convex"),
        ([(math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5)) for k in range(5)], "not convex"),
        ([(0, 0), (1, 0), 3], r"a list of corners \(x, y\) in metres is needed, as in Polygon\(\["),
        ("abc", "a list of corners"),
        (None, "a list of corners"),
        ([[(0, 0), (1, 0), (0, 1)], [(0, 0), (1, 0)]], "has 2 corners"),
    ],
)
def test_what_is_not_a_convex_polygon_is_refused(corners: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        Polygon(corners)


class Both(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("stone", (Polygon(WEDGE), Shape(half_width=1.0)), 1)]


def test_a_polygon_brings_its_shape() -> None:
    with pytest.raises(DeclarationError, match="'stone' has Shape, which Polygon brings: leave Shape out"):
        Worlds((Both(),), 1)


@backends
@pytest.mark.parametrize(
    ("change", "value"),
    [((CORNERS,), 2), ((CORNERS,), 9), ((CORNERS,), np.nan), ((CORNERS,), -1), ((CORNER,), np.nan), ((CORNER,), 1e7),
     ((CORNER,), -0.5), ((CORNER + 2,), 0.6), ((CORNER + 4, CORNER + 5), 0), ((CORNER + 5,), -0.6)],
)  # fmt: skip
def test_polygons_that_box2d_would_not_take_as_they_are_are_invalid(backend: Any, change: Any, value: float) -> None:
    batch, outlines = np.concatenate([circles((0, 0)), boxes((1, 0, 1, 1))]), np.zeros((2, OUTLINE), np.float32)
    become(batch, outlines, 1, Polygon(SQUARE))
    memory, none = backend.make_workspace(), np.zeros((0, 11), np.float32)
    assert solved(backend, memory, batch, none, None, None, outlines)[0] == SOLVED
    outlines[1, list(change)] = value
    result, after, _ = solved(backend, memory, batch, none, None, None, outlines)
    assert result == INVALID
    assert after.tobytes() == batch.tobytes()


@backends
@pytest.mark.parametrize("speed", [3.0, 110.0])
def test_a_disc_stops_at_the_slope_of_a_wedge(backend: Any, speed: float) -> None:
    """So fast that it would be through in a substep, or not; what is beside the slope does not stop it."""
    batch, outlines = np.concatenate([circles((0, 0)), boxes((0, 0, 1, 1))]), np.zeros((2, OUTLINE), np.float32)
    become(batch, outlines, 1, Polygon([(1, -3), (1, 3), (-2, 0)]))
    batch[0, X], batch[0, VX], batch[0, MAX_TRAVEL], batch[1, DYNAMIC] = -3.5 - speed / 120, speed, 10, 0
    middle = float(outlines[1, CORNER::2][: int(outlines[1, CORNERS])].min())
    batch[1, X] = -2 - middle  # its tip is at -2
    result, after, _ = solved(
        backend, backend.make_workspace(), batch, np.zeros((0, 11), np.float32), None, None, outlines
    )
    assert result == SOLVED
    assert after[0, X] < -2.3
