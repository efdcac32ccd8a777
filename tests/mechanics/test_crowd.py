"""Worlds with so many bodies that cameras cull them first, against the naive form that tests every body."""

import numpy as np
import pytest

import outlast
from outlast.components import Body, Sight
from outlast.ecs import Entity
from outlast.ecs.simd import SIMD_WIDTH
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems.cameras import FEW
from tests.conftest import scaled
from tests.helpers import naive_observations
from tests.helpers.ambiguity import collecting
from tests.helpers.naive_world import World, read

WORLDS = scaled(12, least=2)
HEALS = 150
CONES = {
    "sector": {"cameras_cone": "sector", "cameras_items_occlude": False},
    "kite": {"cameras_cone": "kite", "cameras_depth": 6.0},
    "wide": {"cameras_cone": "sector", "cameras_fov": np.pi, "cameras_depth": 5.0},
}


def crowd(cone: str) -> SurvivalVectorEnv:
    """Agents anywhere, at any angle; after a tick in which all idle."""
    scenario = outlast.variant("ffa_4").replace(
        n_agents=4, n_heals=HEALS, n_boxes=4, spawn_grid_cells=16, **CONES[cone]
    )
    env, rng = outlast.make_vec(scenario, WORLDS, seed=1), np.random.default_rng(2)
    env.reset()
    env.worlds[Body].angle[:, : env.num_agents] = rng.uniform(-4, 4, (WORLDS, env.num_agents))
    env.step(np.tile([1, 1, 1, 0, 0, 0], (WORLDS, env.num_agents, 1)))
    return env


def seen(env: SurvivalVectorEnv, w: int) -> list[set[int]]:
    """By agent: rows in the sets that the cameras leave."""
    sets = env.worlds[Sight].visible[w].tolist()
    return [
        {SIMD_WIDTH * g + k for g, word in enumerate(words) for k in range(SIMD_WIDTH) if word >> k & 1}
        for words in sets
    ]


@pytest.mark.parametrize("cone", CONES)
def test_cameras_see_in_a_crowd_what_they_see_one_by_one(cone: str) -> None:
    env, several = crowd(cone), 0
    for w in range(WORLDS):
        assert np.count_nonzero(np.add.reduceat(env.worlds[Entity].alive[w], range(0, HEALS, SIMD_WIDTH))) > FEW
        world: World = read(env, w)
        with collecting() as ambiguities:
            want = naive_observations.see(world)
        got = seen(env, w)
        several += sum(len(rows) > 2 for rows in got)
        differing = sum(len(a ^ b) for a, b in zip(got, want, strict=True))
        assert differing <= len(ambiguities), (got, want)
    env.close()
    assert several >= WORLDS
