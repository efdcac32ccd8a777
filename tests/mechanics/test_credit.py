"""Who gets the credit of a death: the last who took hit points in its tick, not who struck for nothing."""

import numpy as np
import pytest

import outlast
from outlast.components import Health
from outlast.ecs import Entity

ROLES = {name: outlast.role(agents=(i,)) for i, name in enumerate(("strong", "victim"))}


@pytest.mark.parametrize(("strikers", "harm", "by"), [((0, 2), 0, [0]), ((2,), 0, []), ((0, 2), 4, [2])])
def test_the_last_hit_gets_the_credit(strikers: tuple[int, ...], harm: int, by: list[int]) -> None:
    game = outlast.variant("ffa_2").replace(n_agents=3, rewards_kill=100, melee_blocked=False)
    env = outlast.make_vec(game.roles(**ROLES, weak=outlast.role(agents=(2,), melee_damage=harm)), 1, seed=0)
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
    hits = [(e, 1, harm if e else 5) for e in strikers if e == 0 or harm]
    assert events["hit"][["agent", "target", "amount"]].tolist() == hits
    assert events["death"]["by"].tolist() == by
    assert rewards.tolist() == [[101 if e in by else -1 if by and e == 1 else 1 for e in range(3)]]
