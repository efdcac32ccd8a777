"""Tests of the game with coins and mud. Run them: python -m pytest docs/examples/test_coins.py."""

import numpy as np
import pytest
from coins import COINS

import outlast
from outlast.components import Body

FORWARD = [6, 3, 3]  # at full speed: ahead, left, turn


@pytest.fixture
def env():
    """One world, in which agent 0 is near the left wall, and agent 1 in a corner."""
    env = outlast.make_vec(COINS, num_worlds=1, seed=0)
    env.reset()
    env.place("agent", 0, x=-3, y=0, angle=0)
    env.place("agent", 1, x=2, y=3, angle=0)
    return env


def test_a_coin_is_paid_once(env):
    coin = env.place("coin", 0, x=-3, y=0)
    idle = env.noop[None, None].repeat(2, axis=1)
    observations, reward, *_ = env.step(idle)
    assert reward[0].tolist() == [1, 0]
    assert not env.worlds.entity(coin).Entity.alive
    observations, reward, *_ = env.step(idle)
    assert reward[0].tolist() == [0, 0]
    assert observations["coins_mask"][0, :, 0].tolist() == [0, 0]


def test_mud_slows_agents_down(env):
    env.place("agent", 0, x=0, y=0)
    env.step(np.array([[FORWARD, FORWARD]]))
    in_mud, on_floor = env.worlds[Body].vx[0, env.worlds.span("agent")]
    assert on_floor > 1
    assert in_mud == pytest.approx(0.2 * on_floor, rel=0.01)


def test_nothing_is_wrong_with_it():
    assert outlast.check(COINS) == []
