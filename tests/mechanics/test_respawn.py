"""Respawn: when and where agents come back, with what, and what that means for episodes."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.components import Body, Box, Died, Health, Return, Weapon
from outlast.ecs import Entity, NumberError
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import scripted_policy
from outlast.systems import Preparation, Respawn
from tests.conftest import COMPILED, draw_actions, scaled
from tests.helpers.mechanics import idle

WORLDS, DELAY, LIMIT = scaled(60, least=3), 7, scaled(250, least=40)
FIGHT = (
    variant("teams_4")
    .replace(ending_rule="never", ending_limit=LIMIT, agents_health=15, room_size=10.0, cameras_fov=3.0)
    .with_(Respawn(ticks=DELAY))
)


def make(scenario: Any = FIGHT, worlds: int = WORLDS) -> SurvivalVectorEnv:
    return make_vec(scenario, worlds, seed=3)


def test_agents_come_back_after_the_delay_at_a_free_place() -> None:
    """Some wait longer, as no place is free. Episodes end at their limit, and count everything."""
    env = make()
    policy, died, deaths, backs, late = scripted_policy(env), {}, 0, 0, 0
    observations, _ = env.reset()
    for tick in range(1, LIMIT + 1):
        observations, _, terminated, truncated, info = env.step(policy(observations))
        for w, e in zip(*(env.events()["respawned"][key] for key in ("world", "agent")), strict=True):
            assert tick >= died[w, e] + DELAY
            late += tick > died.pop((w, e)) + DELAY
            backs += 1
            assert env.worlds[Died].damage_type[w, e] == env.worlds[Died].source[w, e] == -1 or not info["alive"][w, e]
        for w, e in zip(*(env.events()["death"][key] for key in ("world", "agent")), strict=True):
            died[w, e] = tick
            deaths += 1
        assert all(not info["alive"][w, e] for w, e in died)
        assert info["alive"].sum() == info["alive"].size - len(died)
        assert not terminated.any()
        assert truncated.all() == (tick == LIMIT)
    assert backs > WORLDS / 2 or LIMIT < 100
    assert late <= backs / 5
    statistics = info["statistics"]
    assert statistics["respawns"].sum() == backs
    assert statistics["deaths_melee"].sum() + statistics["deaths_zone"].sum() == deaths
    assert (statistics["length"] == LIMIT).all()


def test_who_comes_back_is_new_and_at_rest() -> None:
    """And touches nothing: that is in test_random_levels.py."""
    env = make(worlds=scaled(300, least=5))
    env.reset()
    rng = np.random.default_rng(0)
    worlds, found = env.worlds, 0
    for _ in range(4):
        _, *_, info = env.step(draw_actions(env, rng))
        worlds[Health].points[:, :4][info["alive"] & (rng.random(info["alive"].shape) < 0.5)] = 0
        worlds[Return].tick[:, :4][worlds[Return].tick[:, :4] > 0] = 0  # now
        before = info["alive"]
        *_, info = env.step(idle(env))
        back, body, health = info["alive"] & ~before, worlds[Body], worlds[Health]
        assert (health.points[:, :4][back] <= 15).all()
        for column in (body.vx, body.vy, body.omega, body.angle):
            assert not column[:, :4][back].any()
        unhurt = back & (health.points[:, :4] == 15)  # by the zone, since
        for column in (*worlds[Died][1:], health.damage_type, health.source, health.fatal_tick):
            assert (column[:, :4][unhurt] == -1).all()
        found += unhurt.sum()
    assert found > 0


@pytest.mark.parametrize("waits", ["preparation", "cooldown"])
def test_ticks_without_attack_pass_for_the_dead_too(waits: str) -> None:
    game = variant("ffa_1").with_(Respawn(ticks=5)).replace(ending_rule="never", ending_limit=99, room_size=9.0)
    game = game.with_(Preparation(ticks=20)) if waits == "preparation" else game.replace(melee_cooldown=20)
    env, struck = make_vec(game, 1, seed=0), {0: [], 1: []}
    env.reset()
    actions = idle(env)
    actions[..., 3] = 1
    if waits == "cooldown":
        env.worlds[Weapon].cooldown[0, :2] = 20
    for tick in range(1, 24):
        if tick == 3:
            env.worlds[Health].points[0, 0] = 0
        env.step(actions)
        for agent in env.events()["strike"]["agent"]:
            struck[int(agent)].append(tick)
    assert (struck[0][0], struck[1][0]) == (21, 21)


def test_where_they_come_back_is_spread_over_the_room() -> None:
    scenario = variant("ffa_2").replace(ending_rule="never", ending_limit=9, n_agents=2).with_(Respawn(ticks=1))
    env = make(scenario, worlds=scaled(4000, least=200))
    env.reset()
    env.worlds[Health].points[:, 0] = 0
    *_, first = env.step(idle(env))
    *_, second = env.step(idle(env) + np.eye(6, dtype=int)[0])
    assert not first["alive"][:, 0].any()
    assert second["alive"].all()
    body = env.worlds[Body]
    counts = np.histogram2d(body.x[:, 0], body.y[:, 0], bins=4, range=[[-12.5, 12.5]] * 2)[0]
    assert counts.min() > (0.5 if COMPILED else 0.25) * counts.mean()
    assert np.unique(body.x[:, 0]).size > 0.99 * env.num_worlds
    assert np.median((body.vx[:, 0], abs(body.vy[:, 0])), 1) == pytest.approx([0.30988, 0], abs=1e-5)  # along +x


def test_roles_have_delays_and_health_of_their_own() -> None:
    roles = {"slow": outlast.role(2, respawn_ticks=5, agents_health=33), "fast": outlast.role(respawn_ticks=1)}
    env = make(FIGHT.replace(room_size=25.0).roles(**roles), worlds=20)
    env.reset()
    env.worlds[Health].points[:, :4] = 0
    lives = [env.step(idle(env))[-1]["alive"].mean(0).tolist() for _ in range(7)]
    assert lives[0] == [0, 0, 0, 0]
    assert lives[1][2:] == [1, 1]
    assert lives[4][:2] == [0, 0]
    assert lives[5][:2] == [1, 1]
    assert (np.median(env.worlds[Health].points[:, :2], 0) == 33).all()  # the zone may have hurt some since


def test_nobody_comes_back_into_a_full_room() -> None:
    scenario = FIGHT.replace(room_size=4.0, n_boxes=1, boxes_width=3.5, boxes_width_deviation=0.0, boxes_height=3.5,
                             boxes_height_deviation=0.0, spawn_grid_cells=3, n_heals=1)  # fmt: skip
    env = make(scenario, worlds=2)
    env.reset()
    worlds = env.worlds
    box = worlds.layout.rows(Box)[0]
    worlds[Body].x[:, box], worlds[Body].y[:, box] = 0, 0
    worlds[Entity].alive[:, :4] = 0
    worlds[Return].tick[:, :4] = 0
    for _ in range(5):
        assert not env.step(idle(env))[-1]["alive"].any()
    worlds[Entity].alive[:, box] = 0
    assert env.step(idle(env))[-1]["alive"].any()


def test_an_episode_with_respawn_has_a_limit() -> None:
    with pytest.raises(NumberError, match='take replace\\(ending_rule="never", ending_limit=1000\\)'):
        make_vec(variant("ffa_1").with_(Respawn()), 1)
    with pytest.raises(NumberError, match=r'ending\.rule = "never" without a limit: .* set ending_limit'):
        make_vec("ffa_1", 1, ending_rule="never")


@pytest.mark.parametrize("make_env", ["parallel_env", "aec_env"])
def test_adapters_in_which_death_ends_an_episode_refuse_it(make_env: str) -> None:
    pytest.importorskip("pettingzoo")
    with pytest.raises(ValueError, match=r"agents come back in this scenario, .*; take dead='keep'"):
        getattr(outlast.adapters, make_env)(FIGHT)
    getattr(outlast.adapters, make_env)(FIGHT, dead="keep").reset()
