"""Limits of what physics takes, masses, and bodies at the edges of rooms and of the plane."""

import math
from pathlib import Path
from typing import Any

import Box2D
import numpy as np
import pytest

import outlast
from outlast.components import Body, Shape, Solid
from outlast.ecs import RESET, NumberError
from outlast.envs.errors import FaultError
from outlast.systems import physics
from outlast.systems.box2d import batch
from tests.helpers.scenario_builder import ScenarioBuilder


@pytest.mark.parametrize("column", ["x", "y", "vx", "vy", "omega"])
@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_what_is_no_number_is_a_fault(column: str, value: float) -> None:
    """Of a body that is alone in the world, so that Box2D never gets to see it."""
    alone = ScenarioBuilder("ffa_1", n_agents=1, n_heals=1, room_walls=False)
    getattr(alone.column(Body), column)[0, 0] = value
    with pytest.raises(FaultError, match="world 0"):
        alone.step()


@pytest.mark.parametrize("column", ["x", "y"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_body_stops_at_the_edge_of_the_plane_and_beyond_a_million_metres_is_a_fault(column: str, sign: int) -> None:
    alone = ScenarioBuilder("ffa_1", n_agents=1, n_heals=1, room_walls=False)
    alone.put("agent", 0, 0, 0)
    place, speed = (getattr(alone.column(Body), name)[0] for name in (column, f"v{column}"))
    place[0], speed[0] = sign * (physics.EDGE - 1), sign * 60
    alone.step()
    assert (place[0], speed[0]) == (sign * physics.EDGE, 0)
    place[0] = sign * 1.001e6
    with pytest.raises(FaultError, match="world 0"):
        alone.step()


def test_whole_turns_are_taken_off_large_angles() -> None:
    """And the heading is that of the angle."""
    alone, turned = ScenarioBuilder("ffa_1"), 10_000 * 2 * math.pi
    body = alone.column(Body)
    for angle in (turned + 1, -turned - 1):
        alone.put("agent", 0, 0, 0, angle)
        alone.step()
        assert body.angle[0, 0] == pytest.approx(angle - math.floor(angle / 2 / math.pi) * 2 * math.pi, abs=0.01)
        assert body.cosine[0, 0] == np.cos(body.angle[0, 0])
        assert abs(body.angle[0, 0]) < 7


@pytest.mark.parametrize("size", [200.0, 10_000.0])
def test_agents_stop_at_the_walls_of_any_room(size: float) -> None:
    game = ScenarioBuilder("ffa_2", room_size=size, safe_zone_damage=0)
    inside = size / 2 * 0.99
    game.put("agent", 0, inside - 0.7, 0)
    game.step({0: "ahead"}, times=60)
    assert game.state(0)[0] == pytest.approx(inside - 0.5, abs=0.02)


@pytest.mark.parametrize(
    "thrust", [{"motors_give": give, "motors_turn": 1e5, "motors_ahead": 1e5} for give in ("evenly", "at once")]
)
def test_agents_of_two_millimetres_are_held_to_box2ds_speed(thrust: dict[str, Any]) -> None:
    """At most 2 m and a quarter turn a substep, in the open and beside a wall."""
    game = ScenarioBuilder("ffa_2", agents_radius=0.002, agents_density=0.001, safe_zone_damage=0, **thrust)
    for x in (0, 12.3):
        game.put("agent", 0, x, 0, math.pi / 2)
        game.step({0: "ahead"})
        assert game.state(0)[1] == pytest.approx(4, abs=0.1)
        game.step({0: "turn"})
        assert game.state(0)[2] - math.pi / 2 == pytest.approx(math.pi, abs=0.1)


def test_physics_takes_as_many_bodies_as_a_batch_holds() -> None:
    """Agents and four walls."""
    most = batch.CAPACITY - 4
    crowd = outlast.variant("ffa_1").replace(n_heals=1, spawn_grid_cells=23)
    outlast.make_vec(crowd.replace(n_agents=most), 1).close()
    with pytest.raises(NumberError, match=f"{batch.CAPACITY + 1} bodies"):
        outlast.make_vec(crowd.replace(n_agents=most + 1), 1)


@pytest.mark.parametrize("density", [1.0, 4.0])
def test_mass_and_inertia_are_those_that_box2d_finds(density: float) -> None:
    """Through its public interface; of agents, and of boxes of random sizes."""
    numbers = {"agents_density": density, "boxes_density": density / 2, "agents_radius": 0.4, "boxes_dynamic": True}
    worlds = outlast.make_vec(outlast.variant("ffa_3").replace(**numbers), 1, seed=0).worlds
    worlds.run(np.full(1, RESET, np.int8))
    solid, shape, world = worlds[Solid], worlds[Shape], Box2D.b2World()
    for kind, own in (("agent", density), ("box", density / 2)):
        for e in range(*worlds.span(kind).indices(worlds.dims["rows"])):
            half = float(shape.half_width[0, e]), float(shape.half_height[0, e])
            outline = Box2D.b2CircleShape(radius=0.4) if kind == "agent" else Box2D.b2PolygonShape(box=half)
            body = world.CreateDynamicBody(fixtures=Box2D.b2FixtureDef(shape=outline, density=own))
            assert (float(solid.mass[0, e]), float(solid.inertia[0, e])) == (body.mass, body.inertia)


def test_box2d_stops_a_body_that_sleeps_and_the_page_says_how_far_ours_turns_on() -> None:
    """A tick of turning, and 259 of nothing."""
    world = Box2D.b2World(gravity=(0, 0))
    body = world.CreateDynamicBody(linearDamping=0.8, angularDamping=0.8)
    body.CreateCircleFixture(radius=0.5, density=1)
    body.ApplyAngularImpulse(0.0125, True)
    for _ in range(2 * 260):
        world.Step(1 / 60, 10, 10)
    game = ScenarioBuilder("ffa_1", safe_zone_damage=0)
    game.put("agent", 0, 0, 0)
    game.step({0: "turn"}).step(times=259)
    page = (Path(__file__).parents[2] / "docs/paper.md").read_text("utf-8")
    assert f"heading of {body.angle:.4f} radians there and {game.state(0)[2]:.4f} here" in page
    assert body.angularVelocity == 0 < game.state(0)[5]
