"""Who gets the credit of a death or a broken box: the last who took hit points, not who struck for nothing."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Guard, Health
from outlast.ecs import Entity

ROLES = {
    "strong": outlast.role(agents=(0,)),
    "victim": outlast.role(agents=(1,)),
    "weak": outlast.role(agents=(2,), melee_damage=0),
}


def between(scenario: Any) -> Any:
    """A world in which agents 0 and 2 stand left and right of the origin, and look at it; nothing else is near."""
    env = outlast.make_vec(scenario.roles(**ROLES), num_worlds=1, seed=0)
    env.reset()
    env.worlds[Entity].alive[0, env.worlds.span("agent").stop :] = 0
    for e, x, y, angle in ((0, -1.3, 0, 0), (1, 0, 9, 0), (2, 1.3, 0, np.pi)):
        env.place("agent", e, x=x, y=y, angle=angle)
    return env


@pytest.mark.parametrize("strikers", [(0, 2), (2,)])
def test_a_strike_of_no_damage_is_no_hit(strikers: tuple[int, ...]) -> None:
    env = between(outlast.variant("ffa_2").replace(n_agents=3, rewards_kill=100, melee_blocked=False))
    env.worlds[Body].y[0, 1], env.worlds[Health].points[0, 1] = 0, 5
    actions = np.tile(env.noop, (1, 3, 1))
    actions[0, strikers, 3] = 1
    _, rewards, *_ = env.step(actions)
    events = env.events()
    assert events["strike"]["agent"].tolist() == [*strikers]
    killed = 0 in strikers
    assert events["hit"][["agent", "target", "amount"]].tolist() == ([(0, 1, 5)] if killed else [])
    assert events["death"]["by"].tolist() == ([0] if killed else [])
    assert rewards.tolist() == [[101, -1, 1] if killed else [1, 1, 1]]


def test_who_breaks_a_box_owns_it() -> None:
    env = between(outlast.variant("ffa_3").replace(n_agents=3, melee_blocked=False, boxes_toughness=5))
    box, body = env.worlds.span("box").start, env.worlds[Body]
    env.worlds[Entity].alive[0, box] = 1
    body.x[0, box], body.y[0, box] = 0, 0
    actions = np.tile(env.noop, (1, 3, 1))
    actions[0, [0, 2], 3] = 1
    env.step(actions)
    assert env.events()["box_broken"]["by"].tolist() == [0]
    assert env.worlds[Guard].vulnerable_only_to[0, box] == 0
