"""Tests of the small examples of physics. Run them: python -m pytest docs/examples/test_physics_examples.py."""

import numpy as np
import pytest
from bouncing_ball import BOUNCING_BALL
from grab import GRAB
from leash import LEASH, Torn
from one_way_door import ONE_WAY_DOOR
from ramp import RAMP
from trap import TRAP
from tumble import TUMBLE

import outlast
from outlast.components import Body, Rope, Weld

STAY, AHEAD, BACK = (1, 1, 1), (2, 1, 1), (0, 1, 1)


def placed(scenario, *places):
    """One world, in which agents stand at these places, at rest, and look to the right."""
    env = outlast.make_vec(scenario, 1, seed=0)
    env.reset()
    body = env.worlds[Body]
    body.x[0, : len(places)], body.y[0, : len(places)] = np.transpose(places)
    return env, body, env.worlds.span


def walk(env, ticks, *actions):
    """Ticks in which the agents do this; the places of the first one afterwards."""
    for _ in range(ticks):
        env.step(np.array([actions]))
    return env.worlds[Body].x[0, 0], env.worlds[Body].y[0, 0]


@pytest.mark.parametrize(
    "scenario", [ONE_WAY_DOOR, RAMP, BOUNCING_BALL, GRAB, LEASH, TRAP, TUMBLE], ids=lambda scenario: scenario.name
)
def test_nothing_is_wrong_with_it(scenario):
    assert outlast.check(scenario) == []


def test_a_one_way_door_lets_nobody_back():
    env, *_ = placed(ONE_WAY_DOOR, (-3, 0))
    assert walk(env, 60, AHEAD)[0] > 3
    assert walk(env, 90, BACK)[0] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(("y", "crosses"), [(0, True), (3, False)])
def test_only_a_ramp_leads_over_a_low_wall(y, crosses):
    env, *_ = placed(RAMP, (-3, y))
    x = walk(env, 90, AHEAD)[0]
    assert x == pytest.approx(5.44 if crosses else 0.8, abs=0.02)


def test_a_ball_goes_on_bouncing_and_a_door_sliding():
    env, body, span = placed(BOUNCING_BALL, (-5, -5))
    ball, door = span("ball").start, span("door").start
    places = []
    for _ in range(290):
        walk(env, 1, STAY)
        places.append(body.y[0, door])
    speed = np.hypot(body.vx[0, ball], body.vy[0, ball])
    assert 4 < speed < 9
    assert max(places) == pytest.approx(3, abs=0.1)
    assert min(places) == pytest.approx(-3, abs=0.1)
    assert np.abs(np.diff(places)).max() == pytest.approx(1 / 30, rel=1e-3)


def test_what_is_grabbed_comes_along_until_it_is_let_go():
    env, body, span = placed(GRAB, (-1.2, 0), (0, 1.2))
    crate, welds = span("crate").start, env.worlds[Weld]
    walk(env, 1, (*STAY, 0), (*STAY, 0))
    assert env.action_masks()[0, :, -1].tolist() == [True, True]
    walk(env, 1, (*STAY, 1), (*STAY, 1))
    assert welds.other[0, :2].tolist() == [crate, crate]
    walk(env, 30, (*BACK, 1), (*STAY, 1))
    assert body.x[0, crate] < -1
    assert np.hypot(body.x[0, 0] - body.x[0, crate], body.y[0, 0] - body.y[0, crate]) == pytest.approx(1.2, abs=0.01)
    walk(env, 1, (*STAY, 0), (*STAY, 0))
    assert welds.other[0, :2].tolist() == [-1, -1]
    assert env.action_masks()[0, :, -1].tolist() == [True, True]  # they are still near
    walk(env, 40, (*STAY, 0), (*AHEAD, 0))
    assert env.action_masks()[0, :, -1].tolist() == [True, False]  # the second one has gone ahead
    assert abs(np.hypot(body.x[0, 1] - body.x[0, crate], body.y[0, 1] - body.y[0, crate]) - 1.2) > 0.3


@pytest.mark.parametrize(("strength", "holds"), [(0, True), (150, False)])
def test_a_leash_holds_until_it_is_pulled_too_hard(strength, holds):
    env, _, span = placed(LEASH.replace(leash_strength=strength), (0.8, 0))
    x = walk(env, 90, AHEAD)[0]
    assert (env.worlds[Rope].other[0, 0] == span("post").start) == holds
    assert x == pytest.approx(3.0 if holds else 5.44, abs=0.05)
    assert env.worlds[Torn].torn[0] == (not holds)


@pytest.mark.parametrize(("y", "caught"), [(0, True), (3, False)])
def test_a_trap_holds_whoever_steps_on_it(y, caught):
    env, *_ = placed(TRAP, (-2, y))
    x = walk(env, 60, AHEAD)[0]
    assert -0.1 < x < 1 if caught else x > 5  # its edge is reached at 0, with up to 0.8 m in a tick
    assert (walk(env, 10, BACK)[0] == x) == caught


def test_a_blade_sweeps_stones_out_of_its_way():
    env, body, span = placed(TUMBLE, (-5, -5))
    stones, blade = slice(span("stone").start, span("stone").stop), span("blade").start
    walk(env, 150, STAY)
    far = np.hypot(body.x[0, stones], body.y[0, stones])
    assert body.angle[0, blade] == pytest.approx(7.5, rel=1e-4)
    assert (far > 3).all()  # farther than its tips and half a stone
    assert (np.abs(body.angle[0, stones]) > 0.05).sum() == 4  # two were out of reach
