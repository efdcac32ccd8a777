"""What must hold in any level: games drawn at random over all generators, rooms, roles, counts and rules."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Health
from outlast.ecs import Entity
from tests.conftest import COMPILED, draw_actions, few_by_day, scaled
from tests.helpers.random_levels import KINDS, LevelChecker, scenario

MILLION, WORLDS, STEPS, HELD = 1_000_000, 256, 125, 20
kinds = pytest.mark.parametrize("kind", few_by_day(KINDS, ("mazes", "plans")))


def play(kind: str, seed: int, worlds: int, steps: int) -> LevelChecker:
    """Random play in a random game, with everything checked at each step. Agents keep a direction for a while."""
    rng = np.random.default_rng(seed)
    env = outlast.make_vec(scenario(kind, rng), worlds, seed=seed)
    checker = LevelChecker(env, 0 if kind == "plans" else scaled(3))
    env.reset()
    checker.check()
    for step in range(steps):
        actions = draw_actions(env, rng)
        if step % HELD == 0:
            held = actions[..., :3]
        actions[..., :3] = held
        checker.check(env.step(actions)[1])
    env.close()
    return checker


@pytest.mark.parametrize("kind", few_by_day(KINDS, ("mazes", "pillars")))
def test_bodies_stay_apart_in_random_levels(kind: str) -> None:
    for seed in range(scaled(2)):
        checker = play(kind, seed, scaled(64, least=2), scaled(60, least=4))
        assert checker.resets > 64 or not COMPILED


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="a million world-steps")
@kinds
def test_bodies_stay_apart_for_a_million_world_steps(kind: str) -> None:
    """In all kinds together, in eight random games of each. Only boxes that are set up squeeze agents into walls."""
    games = MILLION // len(KINDS) // WORLDS // STEPS + 1
    found = [play(kind, 100 + seed, WORLDS, STEPS) for seed in range(games)]
    assert sum(each.resets for each in found) > 1000
    assert sum(each.returns for each in found) > 50 or kind in ("rooms", "pillars")
    assert sum(each.deep for each in found) < 1e-3 * sum(each.ticks for each in found)


@kinds
def test_it_does_not_matter_where_the_absent_are(kind: str) -> None:
    """Bit for bit: they are moved about, with speeds and hit points, in one of two games that are else the same."""
    game = scenario(kind, np.random.default_rng(7))
    plain, moved = (outlast.make_vec(game, scaled(64, least=2), seed=7) for _ in range(2))
    rng, scribbled = np.random.default_rng(8), 0
    seen = [plain.reset()[0], moved.reset()[0]]
    for _ in range(scaled(80, least=5)):
        for key, values in seen[0].items():
            np.testing.assert_array_equal(values, seen[1][key], key)
        scribbled += scribble(moved, rng)
        actions = draw_actions(plain, rng)
        one, two = plain.step(actions), moved.step(actions)
        for mine, its in zip(one[1:4], two[1:4], strict=True):
            np.testing.assert_array_equal(mine, its)
        seen = [one[0], two[0]]
    assert scribbled
    there = plain.worlds[Entity].identity >= 0
    for mine, its in zip(plain.worlds[Body], moved.worlds[Body], strict=True):
        np.testing.assert_array_equal(mine[there], its[there])
    plain.close(), moved.close()


def scribble(env: Any, rng: np.random.Generator) -> int:
    """Other places, speeds and hit points for all that are absent; how many there are."""
    absent = env.worlds[Entity].identity < 0
    body, count = env.worlds[Body], int(absent.sum())
    for column in (body.x, body.y, body.angle, body.vx, body.vy, body.omega):
        column[absent] = rng.uniform(-12, 12, count)
    body.cosine[absent], body.sine[absent] = np.cos(body.angle[absent]), np.sin(body.angle[absent])
    env.worlds[Health].points[absent] = rng.integers(-5, 50, count)
    return count
