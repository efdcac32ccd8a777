"""Motors and steering in hundredths, against those of the paper's variants and its ablation."""

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import Module
from outlast.systems import FineMotors, FineSteering, Motors, Steering
from tests.conftest import scaled

PAIRS = [
    (Motors(), FineMotors(), 1),
    (Motors(give="at once", ahead=0.4), FineMotors(give="at once", ahead=0.4), 1),
    (Steering(), FineSteering(), 3),
]


@pytest.mark.parametrize(("coarse", "fine", "most"), PAIRS, ids=["evenly", "at once", "steering"])
def test_all_and_none_are_those_of_the_coarse_ones(coarse: Module, fine: Module, most: int) -> None:
    """A hundred hundredths are the highest level, bit for bit."""
    scenario = outlast.variant("ffa_3").replace(n_agents=4)
    one, other = (outlast.make_vec(scenario.with_(module), 8, seed=2) for module in (coarse, fine))
    assert other.action_sizes.tolist() == [201, 201, 201, *one.action_sizes[3:]]
    one.reset()
    other.reset()
    rng = np.random.default_rng(0)
    for _ in range(scaled(200, 30)):
        signs, rest = rng.integers(-1, 2, (8, 4, 3)), rng.integers(0, 2, (8, 4, 3))
        one.step(np.concatenate([most + most * signs, rest], -1))
        other.step(np.concatenate([100 + 100 * signs, rest], -1))
        for column in ("x", "y", "angle", "vx", "vy", "omega"):
            assert np.array_equal(getattr(one.worlds[Body], column), getattr(other.worlds[Body], column))


@pytest.mark.parametrize("fine", [FineMotors(), FineMotors(give="at once"), FineSteering()])
def test_speed_is_in_proportion(fine: Module) -> None:
    """After one tick from rest, each component by itself."""
    env = outlast.make_vec(outlast.variant("ffa_1").with_(fine), 101, seed=0)
    env.reset()
    hundredths = np.arange(101)
    actions = np.tile(env.noop, (101, 2, 1))
    actions[:, :, :3] = 100 + hundredths[:, None, None] * [1, -1, 1]
    env.step(actions)
    body, agents = env.worlds[Body], env.worlds.span("agent")
    speed = np.hypot(body.vx[:, agents], body.vy[:, agents])
    for values in (speed, body.omega[:, agents]):
        assert np.allclose(values, values[-1] * hundredths[:, None] / 100, rtol=1e-5, atol=1e-7)
    assert (speed[-1] > 0).all()
    assert (body.omega[-1, agents] > 0).all()


@pytest.mark.parametrize("fine", [FineMotors(), FineSteering()])
def test_styles_play_as_well_by_hundredths(fine: Module) -> None:
    worlds = scaled(256, 8)
    env = outlast.make_vec(outlast.variant("ffa_2").with_(fine), worlds, seed=0)
    won, drawn, lost = outlast.rollout(env, "hunter", others="random").outcomes["random"]
    assert won > 0.7 * (won + drawn + lost)
