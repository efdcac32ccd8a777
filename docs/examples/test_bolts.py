"""Tests of bolts.py. Run it: python -m pytest docs/examples/test_bolts.py."""

import numpy as np
import pytest
from bolts import Bolt, Bolts

import outlast
from outlast.components import Body, Health

IDLE, SHOOT = (1, 1, 1, 0, 0, 0), (1, 1, 1, 1, 0, 0)
SCENARIO = outlast.variant("ffa_1").with_(Bolts(speed=12.0, reach=8.0, damage=10)).replace(n_agents=3, n_heals=1)


def facing(*places, **numbers):
    """One world: agents at these places, all facing +x, and a heal far away."""
    env = outlast.make_vec(SCENARIO.replace(**numbers), 1, seed=0)
    env.reset()
    body = env.worlds[Body]
    body.x[0, :4], body.y[0, :4] = np.transpose([*places, (-9, -9)])
    body.angle[0, :3], body.cosine[0, :3], body.sine[0, :3] = 0, 1, 0
    return env


def ticks_until_hurt(env, most=60):
    """Agent 0 shoots once; in which tick somebody is hurt, and all hit points then."""
    for tick in range(1, most):
        env.step(np.array([[SHOOT if tick == 1 else IDLE, IDLE, IDLE]]))
        points = env.worlds[Health].points[0, :3].tolist()
        if points != [100, 100, 100]:
            return tick, points
    return 0, points


@pytest.mark.parametrize(
    ("places", "numbers", "expected"),
    [
        ([(0, 0), (4.5, 0), (0, 5)], {}, (10, [100, 90, 100])),  # 4 metres to its rim, 0.4 in a tick of 1/30 second
        ([(0, 0), (4.5, 0), (2.5, 0)], {}, (5, [100, 100, 90])),  # the nearer one is in the way
        ([(0, 0), (4.5, 0), (0, 5)], {"bolts_speed": 24.0}, (5, [100, 90, 100])),
        ([(0, 0), (4.5, 0), (0, 5)], {"physics_rate": 30.0}, (5, [100, 90, 100])),  # ticks of 1/15 second
        ([(0, 0), (4.5, 0), (0, 5)], {"bolts_reach": 3.9}, (0, [100, 100, 100])),
        ([(0, 0), (4.5, 1), (0, 5)], {}, (0, [100, 100, 100])),
    ],
)
def test_a_bolt_flies_until_it_hits(places, numbers, expected):
    tick, points = ticks_until_hurt(facing(*places, **numbers))
    assert (points, abs(tick - expected[0]) <= 1) == (expected[1], True)  # rounding may bring it there a tick later


def test_only_one_bolt_flies_and_is_observed():
    env = facing((0, 0), (0, 5), (0, -5))
    start = env.fields["own"]["bolt_left"].start
    seen = env.step(np.array([[SHOOT, IDLE, IDLE]]))[0]["own"][0, :, start : start + 3]
    np.testing.assert_allclose(seen, [[7.6, 0.4, 0], [0, 0, 0], [0, 0, 0]], atol=1e-5)
    for _ in range(18):
        env.step(np.array([[SHOOT, IDLE, IDLE]]))
    assert env.worlds[Bolt].left[0, 0] == pytest.approx(0.4, abs=1e-4)
    for _ in range(2):
        env.step(np.array([[SHOOT, IDLE, IDLE]]))
    assert env.worlds[Bolt].left[0, 0] > 7


def test_deaths_by_bolts_are_counted():
    env = facing((0, 0), (2, 0), (0, 5), bolts_damage=100, ending_limit=20)
    for _ in range(20):
        info = env.step(np.array([[SHOOT, IDLE, IDLE]]))[-1]
    assert info["statistics"]["deaths_bolt"][0] == 1
    assert outlast.check(SCENARIO) == []
