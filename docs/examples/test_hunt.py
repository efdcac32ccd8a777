"""Tests of hunt.py. Run it: python -m pytest docs/examples/test_hunt.py."""

import numpy as np
import pytest
from hunt import HUNT

import outlast
from outlast.components import Body, Health, Side
from outlast.ecs import NumberError

IDLE, STRIKE = (1, 1, 1, 0, 0, 0), (1, 1, 1, 1, 0, 0)


def test_the_first_agents_are_hunters_with_hit_points_of_their_own():
    env = outlast.make_vec(HUNT, 3, seed=0, hunt_hunters=2, hunt_points=250)
    env.reset()
    assert (env.worlds[Side].side[:, :5] == [0, 0, 1, 1, 1]).all()
    assert (env.worlds[Health].points[:, :5] == [250, 250, 100, 100, 100]).all()


@pytest.mark.parametrize(("who", "left"), [(0, 80), (1, 295)])
def test_hunters_do_other_damage_than_their_prey(who, left):
    env = outlast.make_vec(HUNT, 1, seed=0)
    env.reset()
    body, whom = env.worlds[Body], 1 - who
    body.x[0, :5], body.y[0, :5] = [0, 0, 9, -9, 9], [0, 0, 9, 9, -9]
    body.x[0, whom] = 1.5  # the other one stands at 0 and looks along +x
    env.step(np.array([[STRIKE if k == who else IDLE for k in range(5)]]))
    assert env.worlds[Health].points[0, whom] == left


def test_a_hunt_without_prey_is_refused():
    with pytest.raises(NumberError, match=r"hunt.hunters = 5 of 5 agents"):
        outlast.make_vec(HUNT, 1, hunt_hunters=5)
    with pytest.raises(NumberError, match=r"hunt.count = 3 sides: two"):
        outlast.make_vec(HUNT, 1, hunt_count=3)
