"""Convex polygons: they are Box2D's to the bit, and what cannot be is refused in a sentence."""

import ctypes
import math
from typing import Any

import Box2D
import numpy as np
import pytest

from outlast.components import Body, Polygon, Push, Shape, Solid
from outlast.ecs import RESET, Archetype, DeclarationError, Module, Worlds
from outlast.systems import Physics
from outlast.systems.box2d import layout, outline
from tests.conftest import scaled
from tests.helpers.contact_batches import corners_of, outline_of, random_polygon
from tests.physics.test_box2d import needs_native
from tests.physics.test_whole_worlds import shape_of

WEDGE = [(0, 0), (2, 0), (0, 1)]


@needs_native
def test_a_polygon_is_written_as_box2d_sets_it() -> None:
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
        for k, corner in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
            memory.set_vertex(k, *corner)
        after = ctypes.string_at(int(memory.this), layout.POLYGON_SIZE)
        for start, size in (layout.POLYGON_CENTROID, 8), (layout.POLYGON_NORMALS, 32), (layout.POLYGON_COUNT, 4):
            assert after[start : start + size] == box[start : start + size]


class Heap(Module):
    """Kinds of many polygons, discs and boxes."""

    def archetypes(self) -> list[Archetype]:
        rng, count = np.random.default_rng(2), scaled(150, 30)
        radius, width, height, density = rng.uniform(0.1, 5, (4, count)).astype(np.float32)
        polygons = Polygon([corners_of(random_polygon(rng)) for _ in range(count)])
        shapes = {"stone": polygons, "disc": Shape(radius=radius), "box": Shape(half_width=width, half_height=height)}
        solid = Body(), Push(), Solid(density=density)
        return [Archetype(name, (*solid, shape), count) for name, shape in shapes.items()]


def test_mass_and_moment_of_inertia_are_those_of_box2d() -> None:
    made = Worlds((Heap(), Physics()), 1)
    made.run(np.full(1, RESET, np.int8))
    solid, world = made[Solid], Box2D.b2World()
    for e in made.layout.rows(Solid):
        shape, density = shape_of(made, 0, e), float(solid.density[0, e])
        data = world.CreateStaticBody().CreateFixture(shape=shape, density=density).massData
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
        ([(0, 0), (1e5, 0), (0, 1)], r"corner 1 is \(100000, 0\)"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "corners 1 and 2 are less than 5 mm apart; leave one of them out"),
        ([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], "corners 4 and 0 are less than 5 mm apart"),
        ([(0, 0), (1, 0), (2, 0), (0, 1)], "corners 0, 1 and 2 are in line, within 5 mm; leave the middle one out"),
        ([(0, 0), (2, 0), (0.5, 0.5), (0, 2)], "not convex: corner . is outside of the edge from corner . to corner ."),
        ([(math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5)) for k in range(5)], "not convex"),
        ([(0, 0), (1, 0), 3], r"a list of corners \(x, y\) in metres is needed, as in Polygon\(\["),
        ("abc", "a list of corners"),
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
