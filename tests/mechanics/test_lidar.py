"""Lidar: what rays read is how far it is to walls, or to all bodies."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import Scenario, make_vec, variant
from outlast.components import Body, Side, Solid, Spawned
from outlast.ecs import Entity, NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems import FreeForAll, Lidar, Maze, Pillars, Preparation, Respawn, Rooms
from tests.conftest import COMPILED, draw_actions, scaled
from tests.helpers import naive_lidar
from tests.helpers.naive_world import read
from tests.helpers.random_worlds import PILLARS, RUNS, TEXT, scramble
from tests.mechanics.test_inner_walls import duel
from tests.mechanics.test_sight_lines import Box2DWorld

WORLDS = scaled(60, least=3)
FEW = scaled(16, least=2)  # that the naive form looks at
EMPTY = variant("ffa_1").replace(safe_zone_damage=0)
IDLE = [1, 1, 1, 0, 0, 0]


def measured(env: SurvivalVectorEnv, *poses: tuple[float, float, float]) -> Any:
    """What the agents of world 0 read who are put there, float32 (agents, rays)."""
    for agent, (x, y, angle) in enumerate(poses):
        env.place("agent", agent, x=x, y=y, angle=angle, vx=0, vy=0, omega=0)
    return env.step(np.tile(IDLE, (1, env.num_agents, 1)))[0]["lidar"][0]


def test_an_odd_number_of_rays_has_one_straight_ahead_and_they_go_from_right_to_left() -> None:
    env = make_vec(EMPTY.with_(Lidar(rays=3, angle=3 * math.pi / 2, depth=30.0)), 1, seed=0)
    env.reset()
    wall = 12.5 * 0.99
    assert measured(env, (2, 5, 0), (0, -4, math.pi / 2))[0] == pytest.approx([5 + wall, wall - 2, wall - 5], abs=1e-4)
    assert measured(env, (2, 5, 0), (0, -4, math.pi / 2))[1] == pytest.approx([wall, wall + 4, wall], abs=1e-4)


@pytest.mark.parametrize("rays", [1, 4, 7])
def test_a_whole_turn_is_divided_into_equal_parts_without_a_double_ray(rays: int) -> None:
    env = make_vec(EMPTY.with_(Lidar(rays=rays, depth=30.0)), 1, seed=0)
    env.reset()
    found = measured(env, (0, 0, 0.3), (5, 5, 0))[0]
    angles = 0.3 + 2 * math.pi * ((np.arange(rays) + 0.5) / rays - 0.5)
    reach = 12.5 * 0.99 / np.maximum(abs(np.cos(angles)), abs(np.sin(angles)))
    np.testing.assert_allclose(found, reach, atol=1e-4)


def test_rays_end_at_their_depth() -> None:
    env = make_vec(EMPTY.replace(room_walls=False).with_(Lidar(depth=6.5)), 1, seed=0)
    assert (env.reset()[0]["lidar"] == 6.5).all()


@pytest.mark.parametrize(("targets", "ahead"), [("walls", 8.0), ("solids", 3.5), ("bodies", 1.75)])
def test_targets_are_walls_or_all_that_collides_or_all_bodies(targets: str, ahead: float) -> None:
    """An item at 2 metres, an agent at 4, and a block at 8."""
    env, body = duel((9, 0, 2, 4, 0, 0), heals_count=1, heals_radius=0.25)
    env = make_vec(env.scenario.with_(Lidar(rays=1, targets=targets)), 1, seed=0)
    env.reset()
    body = env.worlds[Body]
    heal = env.worlds.span("heal").start
    body.x[0, heal], body.y[0, heal] = 2, 0
    found = measured(env, (0, 0, 0), (4, 0, 1))
    assert found[0, 0] == pytest.approx(ahead, abs=1e-4)


NAIVE: dict[str, Scenario] = {
    "walls": variant("ffa_4").replace(**RUNS).with_(PILLARS, Lidar(depth=7.0)),
    "solids": variant("teams_4").replace(**TEXT).with_(PILLARS, Lidar(rays=11, angle=2.5, targets="solids")),
    "bodies": variant("teams_4").replace(**RUNS).with_(Maze(), Lidar(rays=9, targets="bodies", depth=30.0)),
    "roles": variant("ffa_4")
    .replace(**RUNS)
    .with_(PILLARS, Lidar(targets="solids"))
    .roles(
        far=outlast.role(2, lidar_depth=20.0, lidar_angle=0.5, agents_radius=0.54),
        near=outlast.role(lidar_depth=outlast.distributions.uniform(1.0, 3.0), lidar_angle=2 * math.pi),
        drawn="anyone",
        observed=False,
    ),
}


@pytest.mark.parametrize("name", NAIVE)
@pytest.mark.by_day(2)
def test_distances_are_those_of_the_naive_form(name: str) -> None:
    """In random worlds, crowded or not, with dead agents and items anywhere, and a tick later."""
    env, rng = make_vec(NAIVE[name], FEW, seed=5), np.random.default_rng(6)
    env.reset()
    for w in range(FEW):
        scramble(env, w, rng)
    grazing = total = 0
    for _ in range(2):
        observations = env.step(draw_actions(env, rng))[0]
        assert env.observation_space.contains(observations)
        for w in np.flatnonzero(env.worlds[Entity].alive[:, : env.num_agents].any(1)).tolist():
            world = read(env, w)
            for me in world.of("agent"):
                rays = naive_lidar.directions(world, me)
                low, high = np.array([naive_lidar.distance(world, me, angle) for angle in rays]).T
                read_now = observations["lidar"][w, me.index]
                assert ((low <= read_now) & (read_now <= high)).all(), (w, me.index, low, read_now, high)
                grazing, total = grazing + int((high - low > 1e-2).sum()), total + len(low)
    assert total > 80 * FEW
    assert grazing <= 0.002 * total + 2


LEVELS: dict[str, tuple[Any, dict[str, float]]] = {
    "maze": (Maze(), {}),
    "rooms": (Rooms(), {"room_width": 40.0, "room_height": 16.0}),
    "pillars": (Pillars(count=30, least=0.4, most=0.9, gap=1.1), {}),
}


@pytest.mark.skipif(not COMPILED, reason="many rays")
@pytest.mark.parametrize("targets", ["walls", "solids", "bodies"])
@pytest.mark.parametrize("level", LEVELS)
def test_rays_are_box2ds_ray_casts(level: str, targets: str) -> None:
    """3,072 rays of each kind, 27,648 in all, to a tenth of a millimetre.

    The engine's ray is its direction rounded to float32, which moves its end, 10 m away, by at most 1e-6 m; Box2D's own
    goes through two rounded points. A side that is met at an angle of 1 degree turns that into 6e-5 m. Rays that graze
    a corner may differ by any length, and must be told by the naive form.
    """
    mechanic, numbers = LEVELS[level]
    zone = {"safe_zone_radii": (7.0, 4.0)} if numbers else {}
    scenario = variant("ffa_4").replace(n_agents=4, n_heals=20, **numbers, **zone)
    env = make_vec(scenario.with_(mechanic, Lidar(rays=48, targets=targets)), 16, seed=4)
    observations, _ = env.reset()
    rows = env.worlds.layout.rows
    kinds = {"walls": {*rows(Solid)} - {*rows(Spawned)}, "solids": {*rows(Solid)}, "bodies": {*rows(Body)}}
    hits = grazing = 0
    for w in range(env.num_worlds):
        there = Box2DWorld(env.worlds, w)
        naive = read(env, w)
        for i, e in enumerate(rows(Side).tolist()):
            eye, me = there.bodies[e].position, naive.of("agent")[i]
            for k, angle in enumerate(naive_lidar.directions(naive, me)):
                end = eye[0] + 10 * math.cos(angle), eye[1] + 10 * math.sin(angle)
                fraction, _ = there.cast(eye, end, kinds[targets] - {e})
                got, hits = float(observations["lidar"][w, i, k]), hits + (fraction < 1)
                if abs(got - 10 * fraction) > 1e-4:
                    low, high = naive_lidar.distance(naive, me, angle)
                    assert low <= got <= high
                    assert high - low > 1e-2
                    grazing += 1
    assert 1000 < hits < 3072
    assert grazing <= 6
    env.close()


def test_the_dead_read_nothing_until_they_come_back() -> None:
    scenario = EMPTY.with_(Lidar(), Respawn(ticks=3)).replace(ending_rule="never", ending_limit=50)
    env = make_vec(scenario.replace(safe_zone_damage=1000, safe_zone_radii=(1.0,)), 1, seed=0)
    alive = env.worlds[Entity].alive
    env.reset()
    seen = set()
    for _ in range(8):
        lidar = measured(env)
        assert ((lidar > 0).all(1) == (alive[0, :2] == 1)).all()
        assert ((lidar == 0).all(1) == (alive[0, :2] == 0)).all()
        seen |= {*alive[0, :2].tolist()}
    assert seen == {0, 1}


def test_absent_agents_read_nothing() -> None:
    varied = (
        variant("ffa_3")
        .with_(Lidar())
        .vary(n_agents=outlast.distributions.integers(2, 6), lidar_depth=outlast.distributions.uniform(2, 9))
    )
    env = make_vec(varied, WORLDS, seed=1)
    observations, info = env.reset()
    present, depth = info["present"], info["numbers"]["lidar_depth"]
    assert 0 < present.mean() < 1
    assert (observations["lidar"][~present] == 0).all()
    assert (observations["lidar"][present] > 0).all()
    assert (observations["lidar"].max((1, 2)) <= depth).all()
    assert (observations["lidar"].max((1, 2)) == depth).mean() > 0.9
    assert env.observation_space["lidar"].high.max() == 9
    assert env.observation_space.contains(observations)


def test_the_blind_read_nothing_until_their_first_choice() -> None:
    env = make_vec(variant("teams_2").with_(Lidar(), Preparation(ticks=5, sides=(1,), blind=True)), WORLDS, seed=1)
    observations, _ = env.reset()
    for tick in range(8):
        assert (observations["lidar"][:, :2] > 0).all()
        assert (observations["lidar"][:, 2:] > 0).all() == (tick >= 5)
        assert (observations["lidar"][:, 2:] == 0).all() == (tick < 5)
        observations = env.step(np.tile(IDLE, (WORLDS, 4, 1)))[0]


def test_the_number_of_rays_is_the_same_everywhere() -> None:
    with pytest.raises(NumberError, match=r"lidar_rays cannot vary: Lidar.dims\(\) reads it"):
        make_vec(EMPTY.with_(Lidar()).vary(lidar_rays=outlast.distributions.integers(3, 9)), 1)
    with pytest.raises(ValueError, match="lidar_rays is the same for all agents"):
        EMPTY.with_(Lidar()).roles(one=outlast.role(1, lidar_rays=3), other=outlast.role())


def test_it_is_an_observation_of_its_own_with_a_scale() -> None:
    env = make_vec(EMPTY.with_(Lidar(rays=5, depth=20.0), FreeForAll()), 1, seed=0)
    observations, _ = env.reset()
    field = env.fields["lidar"]["distance"]
    assert (field.size, field.scale, field.unit, field.low) == (5, 20.0, "m", 0)
    assert env.single_observation_space["lidar"].shape[-1] == 5
    np.testing.assert_array_equal(
        outlast.adapters.scaled(observations, env.fields)["lidar"], observations["lidar"] / 20
    )
    assert {key: array.shape for key, array in observations.items() if key in ("own", "others")} == {
        key: array.shape for key, array in make_vec(EMPTY, 1).reset()[0].items() if key in ("own", "others")
    }
