"""Limits of what physics takes, masses, and bodies at the edges of rooms and of the plane."""

import math
from pathlib import Path
from typing import Any

import Box2D
import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import NumberError
from outlast.envs.errors import FaultError
from outlast.systems import physics
from outlast.systems.box2d import batch
from tests.helpers.scenario_builder import ScenarioBuilder


@pytest.mark.parametrize("column", ["x", "y", "vx", "vy", "omega"])
@pytest.mark.parametrize("value", [math.nan, -math.inf])
def test_what_is_no_number_is_a_fault(column: str, value: float) -> None:
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
    for x, heading in (0, 0), (12.3, math.pi / 2):
        game.put("agent", 0, x, 0, heading)
        game.step({0: "ahead"})
        assert game.state(0)[:2] == pytest.approx((4, 0) if x == 0 else (x, 4), abs=0.1)
        game.step({0: "turn"})
        assert game.state(0)[2] - heading == pytest.approx(math.pi, abs=0.1)


def test_physics_takes_as_many_bodies_as_a_batch_holds() -> None:
    most = batch.CAPACITY - 4
    crowd = outlast.variant("ffa_1").replace(n_heals=1, spawn_grid_cells=23)
    outlast.make_vec(crowd.replace(n_agents=most), 1).close()
    with pytest.raises(NumberError, match=f"{batch.CAPACITY + 1} bodies"):
        outlast.make_vec(crowd.replace(n_agents=most + 1), 1)


def test_box2d_stops_a_body_that_sleeps_and_the_page_says_how_far_ours_turns_on() -> None:
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
