"""Lidar: what rays read is how far it is to walls, or to all bodies."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import Scenario, make_vec, variant
from outlast.ecs import Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems import FreeForAll, Lidar, Maze, Preparation, Respawn
from tests.conftest import draw_actions, scaled
from tests.helpers import naive_lidar
from tests.helpers.naive_world import read
from tests.helpers.random_worlds import PILLARS, RUNS, TEXT, scramble

WORLDS = scaled(60, least=3)
FEW = scaled(8, least=2)  # that the naive form looks at
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


ROLES = {
    "far": outlast.role(2, lidar_depth=20.0, lidar_angle=0.5, agents_radius=0.54),
    "near": outlast.role(lidar_depth=outlast.distributions.uniform(1.0, 3.0), lidar_angle=2 * math.pi),
}
FFA, TEAMS = variant("ffa_4").replace(**RUNS), variant("teams_4").replace(**RUNS)
NAIVE: dict[str, Scenario] = {
    "walls": FFA.with_(PILLARS, Lidar(depth=7.0)),
    "solids": TEAMS.replace(**TEXT).with_(PILLARS, Lidar(rays=11, angle=2.5, targets="solids")),
    "bodies": TEAMS.with_(Maze(), Lidar(rays=9, targets="bodies", depth=30.0)),
    "roles": FFA.with_(PILLARS, Lidar(targets="solids")).roles(**ROLES, drawn="anyone", observed=False),
}


@pytest.mark.parametrize("name", NAIVE)
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


def test_it_is_an_observation_of_its_own_with_a_scale() -> None:
    env = make_vec(EMPTY.with_(Lidar(rays=5, depth=20.0), FreeForAll()), 1, seed=0)
    observations, _ = env.reset()
    field = env.fields["lidar"]["distance"]
    assert (field.size, field.scale, field.unit, field.low) == (5, 20.0, "m", 0)
    scaled_down = outlast.adapters.scaled(observations, env.fields)["lidar"]
    np.testing.assert_array_equal(scaled_down, observations["lidar"] / 20)
