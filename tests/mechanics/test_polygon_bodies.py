"""Polygons among other bodies: sight, rays and strikes meet their sides, and they find places with their own size."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Body, Polygon, Push, Shape, Solid, Spawned
from outlast.ecs import Archetype, Module, number
from outlast.envs.rendering.scene import Scene
from outlast.envs.web.world_json import describe
from tests.conftest import scaled
from tests.mechanics.test_clear import faced

WEDGE = [(-2 / 3, -2 / 3), (1 / 3, -2 / 3), (1 / 3, 4 / 3)]  # around its centre of mass
HEIGHTS = [(-0.5, 5 / 12), (1.0, 7 / 6), (-1.0, None)]  # of a ray to the right, and where it meets the wedge at (1, 0)


@dataclass(frozen=True)
class Wedges(Module):
    """A wedge between two agents; the others are far away."""

    count: int = number(1, low=1, high=400)

    def archetypes(self) -> list[Archetype]:
        far = [9.0] * (self.count - 1)
        return [Archetype("wedge", (Body(x=[1.0, *far], y=[0.0, *far]), Polygon(WEDGE), Solid()), self.count)]


@pytest.mark.parametrize("count", [1, 200])  # as few bodies, and as a crowd
@pytest.mark.parametrize(("height", "meets"), HEIGHTS)
@pytest.mark.parametrize("blocked", [True, False])
def test_sight_rays_and_strikes_end_at_sides(height: float, meets: float | None, count: int, blocked: bool) -> None:
    """At the last height, a ray would meet the rectangle around the wedge."""
    env, found = faced(Wedges(count=count), blocked, -1, 3, height)
    clear = int(meets is None)
    expected = [clear, 3.5 if clear else 1 + meets, 90 if clear or not blocked else 100]
    assert found == pytest.approx(expected, abs=1e-3)
    wedge = env.worlds.span("wedge").start
    assert env.query().line_of_sight(0, 1) == clear
    assert env.query().near(1.0, -0.8, 0.1, Polygon) == []
    assert env.query().near(1.0, -0.8, 0.2, Polygon) == [wedge]


def test_pages_get_corners() -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Wedges()), 1, seed=0)
    env.reset()
    (wedge,) = (each for each in describe(env.worlds, 0)["objects"] if each["kind"] == "wedge")
    assert wedge["corners"] == [[0.3333, -0.6667], [0.3333, 1.3333], [-0.6667, -0.6667]]
    assert (wedge["radius"], wedge["width"], wedge["height"]) == (0, 1.3333, 2.6667)
    others = [each["corners"] for each in describe(env.worlds, 0)["objects"] if each["kind"] != "wedge"]
    assert others
    assert not any(others)


def test_pictures_have_sides_moved_outwards_or_inwards() -> None:
    env: Any = outlast.make_vec(outlast.variant("ffa_1").with_(Wedges()), 1, seed=0)
    env.reset()
    row = env.place("wedge", 0, x=2, y=3, angle=np.pi / 2)
    scene = Scene(env.worlds, 0)
    np.testing.assert_allclose(
        scene.outline(row), [(2 + 2 / 3, 3 + 1 / 3), (2 - 4 / 3, 3 + 1 / 3), (2 + 2 / 3, 3 - 2 / 3)], atol=1e-5
    )
    grown = np.array(scene.outline(row, 0.1))
    np.testing.assert_allclose(grown[:2, 1], 3 + 1 / 3 + 0.1, atol=1e-5)
    assert grown[0, 0] == pytest.approx(2 + 2 / 3 + 0.1, abs=1e-5)
    assert scene.least_half(row) == pytest.approx(2 / 3 / np.sqrt(5))


@dataclass(frozen=True)
class Rubble(Module):
    """Wedges that find places."""

    def archetypes(self) -> list[Archetype]:
        return [Archetype("stone", (Body(omega=2.0), Push(), Polygon(WEDGE), Solid(dynamic=1), Spawned()), 6)]


def test_polygons_find_places_among_walls_and_keep_their_size() -> None:
    env: Any = outlast.make_vec(outlast.variant("ffa_4").with_(systems.Rooms(), Rubble()), scaled(40, 3), seed=0)
    env.reset()
    rows = env.worlds.span("stone")
    np.testing.assert_allclose(env.worlds[Shape].half_width[:, rows], 2 / 3, rtol=1e-6)
    np.testing.assert_allclose(env.worlds[Shape].half_height[:, rows], 4 / 3, rtol=1e-6)
    for w in range(env.worlds.count):
        query = env.query(w)
        assert [e for e in range(rows.start, rows.stop) if query.within(e, 0.0, Solid)] == []


@pytest.mark.parametrize("column", ["half_width", "radius", "Polygon.x", "corners"])
def test_the_outline_of_a_polygon_cannot_be_placed(column: str) -> None:
    env: Any = outlast.make_vec(outlast.variant("ffa_1").with_(Wedges()), 1, seed=0)
    env.reset()
    with pytest.raises(ValueError, match=f"{column.rpartition('.')[2]}: the outline of the kind 'wedge' is its"):
        env.place("wedge", 0, **{column: 1})
