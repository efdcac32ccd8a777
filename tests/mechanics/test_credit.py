"""Who gets the credit of a death: the last who took hit points, not who struck for nothing."""

import numpy as np
import pytest

import outlast
from outlast.components import Health
from outlast.ecs import Entity

ROLES = {
    "strong": outlast.role(agents=(0,)),
    "victim": outlast.role(agents=(1,)),
    "weak": outlast.role(agents=(2,), melee_damage=0),
}


@pytest.mark.parametrize("strikers", [(0, 2), (2,)])
def test_a_strike_of_no_damage_is_no_hit(strikers: tuple[int, ...]) -> None:
    game = outlast.variant("ffa_2").replace(n_agents=3, rewards_kill=100, melee_blocked=False)
    env = outlast.make_vec(game.roles(**ROLES), num_worlds=1, seed=0)
    env.reset()
    env.worlds[Entity].alive[0, env.worlds.span("agent").stop :] = 0
    for e, x, angle in ((0, -1.3, 0), (1, 0, 0), (2, 1.3, np.pi)):
        env.place("agent", e, x=x, y=0, angle=angle)
    env.worlds[Health].points[0, 1] = 5
    actions = np.tile(env.noop, (1, 3, 1))
    actions[0, strikers, 3] = 1
    _, rewards, *_ = env.step(actions)
    events = env.events()
    assert events["strike"]["agent"].tolist() == [*strikers]
    killed = 0 in strikers
    assert events["hit"][["agent", "target", "amount"]].tolist() == ([(0, 1, 5)] if killed else [])
    assert events["death"]["by"].tolist() == ([0] if killed else [])
    assert rewards.tolist() == [[101, -1, 1] if killed else [1, 1, 1]]
