"""Worlds with many bodies: cameras that cull them first, against the naive form; and rooms that are too small."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import outlast
from outlast.components import Body, Phase, Side, Sight
from outlast.ecs import Entity, Module, Rows, Write, number
from outlast.ecs.kernels.simd import SIMD_WIDTH
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems.cameras import cone_ends
from outlast.systems.geometry.bodies import FEW
from outlast.systems.observation_rows import WORD
from tests.conftest import draw_actions, nightly_compiled, scaled
from tests.helpers import naive_observations
from tests.helpers.ambiguity import collecting
from tests.helpers.naive_world import World, read

WORLDS = scaled(12, least=2)
HEALS = 270
CONES = {
    "sector": {"cameras_cone": "sector", "cameras_items_occlude": False},
    "kite": {"cameras_cone": "kite", "cameras_depth": 6.0},
    "wide": {"cameras_cone": "sector", "cameras_fov": np.pi, "cameras_depth": 5.0},
}


def crowd(cone: str, **numbers: float) -> SurvivalVectorEnv:
    """Agents anywhere, at any angle; after a tick in which all idle."""
    given = {"n_agents": 4, "n_heals": HEALS, "n_boxes": 4, "spawn_grid_cells": 19} | CONES[cone] | numbers
    scenario = outlast.variant("ffa_4").replace(**given)
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


@pytest.mark.parametrize("fov", [0.3, 1.3, 3.1])
def test_a_box_is_as_large_as_the_cone_in_it(fov: float) -> None:
    for heading in np.linspace(-3.1, 3.1, 31):
        rim = 7 * np.cos(heading + np.linspace(-fov / 2, fov / 2, 999))
        found = cone_ends(np.cos(heading), np.sin(heading), 7.0, np.cos(fov / 2), np.sin(fov / 2))
        assert found == pytest.approx((min(0, *rim), max(0, *rim)), abs=1e-4)


def test_rows_of_a_crowd_are_those_of_what_is_seen() -> None:
    env, shown = crowd("wide", n_heals=SIMD_WIDTH * (WORD + 1), spawn_grid_cells=34), 0
    for _ in range(2):  # what is no longer seen is zero again
        env.worlds[Body].angle[:, : env.num_agents] += 2
        observations = env.step(np.tile([1, 1, 1, 0, 0, 0], (WORLDS, env.num_agents, 1)))[0]
        body, rows = env.worlds[Body], env.worlds.span("heal")
        for w in range(WORLDS):
            visible = np.array([[e in each for e in range(rows.start, rows.stop)] for each in seen(env, w)])
            np.testing.assert_array_equal(observations["heals_mask"][w], visible)
            places = np.stack([body.x[w, rows], body.y[w, rows]], 1)
            np.testing.assert_array_equal(observations["heals"][w], np.where(visible[:, :, None], places, 0))
            shown += visible.sum()
    env.close()
    assert shown > WORLDS


# ---- nobody leaves the room


@nightly_compiled
@settings(max_examples=scaled(60, least=3), deadline=None, derandomize=True)
@given(
    st.fixed_dictionaries({
        "room_size": st.floats(3, 12), "spawn_grid_cells": st.integers(5, 7), "n_agents": st.integers(1, 12),
        "n_boxes": st.integers(1, 13), "agents_radius": st.floats(0.1, 1), "boxes_width": st.floats(0.1, 3),
        "boxes_height": st.floats(0.1, 3), "boxes_width_deviation": st.floats(0, 3), "boxes_dynamic": st.booleans(),
        "motors_ahead": st.floats(0.25, 50), "ending_rule": st.just("all dead"),
    }),
    st.integers(0, 2**31),
)  # fmt: skip
def test_nobody_leaves_a_crowded_room(numbers: dict[str, Any], seed: int) -> None:
    scenario = outlast.variant("ffa_3").without("heals", "safe_zone").replace(**numbers)
    env, rng = outlast.make_vec(scenario, scaled(8, least=1), seed=seed), np.random.default_rng(seed)
    env.reset()
    agents, body = env.worlds.span("agent"), env.worlds[Body]
    for _ in range(scaled(100, least=10)):
        env.step(draw_actions(env, rng))
        assert max(np.abs(body.x[:, agents]).max(), np.abs(body.y[:, agents]).max()) <= numbers["room_size"] / 2
    env.close()


@dataclass(frozen=True)
class Wind(Module):
    speed: float = number(3.0)  # metres a tick


@Wind.system(Phase.MOVE, after="physics")
def blow(body: Write[Body], agents: Rows[Side], speed: float) -> None:
    for e in agents:
        body.x[e] += speed
        body.y[e] -= 2 * speed
        body.vx[e] = speed


@pytest.mark.parametrize("physics", [True, False])
def test_nobody_is_moved_out_of_the_room_by_other_mechanics(physics: bool) -> None:
    """Room.keep_inside comes after all that moves bodies, and needs no physics."""
    scenario = outlast.variant("ffa_1").with_(Wind())
    env = outlast.make_vec(scenario if physics else scenario.without("physics"), 2, seed=0)
    labels = [system.label for system in env.worlds.schedule.systems]
    assert labels.index("wind.blow") < labels.index("room.keep_inside")
    env.reset()
    agents, body = env.worlds.span("agent"), env.worlds[Body]
    for _ in range(30):
        env.step(np.full((2, 2, 6), env.noop))
        assert max(np.abs(body.x[:, agents]).max(), np.abs(body.y[:, agents]).max()) <= 12.5
    assert (body.x[:, agents] > 11).all()
    assert (body.vx[:, agents] <= 3).all()
