"""`DropLast`, which is in no variant, against plain Python."""

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Item
from outlast.ecs import Entity
from outlast.systems import DropLast
from tests.helpers import naive_mechanics
from tests.helpers.naive_world import TOLERANCE, read
from tests.helpers.random_worlds import RUNS


def test_the_last_item_lies_ahead() -> None:
    env = outlast.make_vec(outlast.variant("teams_4").replace(**RUNS).with_(DropLast(offset=1.5)), 20, seed=4)
    tables, rng, agents = env.worlds, np.random.default_rng(4), range(env.num_agents)
    env.reset()
    heals, body = tables.span("heal").start, tables[Body]
    tables[Entity].alive[::5, 0] = 0
    body.angle[:] = rng.uniform(-4, 4, (20, 1))
    body.cosine[:], body.sine[:] = np.cos(body.angle), np.sin(body.angle)
    for agent in agents:
        held = min(agent, 2)
        items = np.arange(heals + 2 * agent, heals + 2 * agent + held)
        tables[Bag].items[:, agent, :held], tables[Bag].count[:, agent] = items, held
        tables[Item].holder[:, items], tables[Entity].alive[:, items] = agent, 0
    before, drops = [read(env, w) for w in range(20)], rng.integers(0, 2, (20, len(agents)))
    actions = np.tile(env.noop, (20, len(agents), 1))
    actions[..., [name for name, _ in env.action_columns].index("drop")] = drops
    env.step(actions)
    for w in range(20):
        after = read(env, w)
        for agent in before[w].of("agent"):
            dropped = agent.here and drops[w, agent.index] and agent.bag
            assert after.of("agent")[agent.index].bag == (agent.bag[:-1] if dropped else agent.bag)
            if dropped:
                item, (x, y) = after.entities[agent.bag[-1]], naive_mechanics.ahead(agent, 1.5)
                assert (item.here, item.holder) == (True, -1)
                assert (item.x, item.y) == pytest.approx((agent.x + x, agent.y + y), abs=TOLERANCE)
