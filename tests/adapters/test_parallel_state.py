"""PettingZoo: the global state shows everything, and worlds can be saved and gone on from."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Box, Health, SelfView, Shape, Wall
from outlast.ecs import Entity, Worlds
from outlast.envs.core.agents import present
from outlast.envs.core.global_state import GlobalState
from outlast.systems import GiveLast, Heals, Inventory, Pickup, SafeZone
from tests.adapters.test_parallel import act, both, play, same, short
from tests.conftest import scaled
from tests.helpers.execution_modes import ALL, MAZE, ROLES

BUSY: dict[str, Any] = {  # items change hands all the time, and all agents observe everything
    "n_agents": 4, "agents_health": 100000, "cameras_mode": "omniscient", "pickup_reach": 5.0, "melee_reach": 6.0,
    "boxes_toughness": 1, "boxes_owned": False, "max_cycles": 200,
}  # fmt: skip


def blocks(state: Any, features: int, heals: int, boxes: int) -> list[Any]:
    """agents, zone, objects and items, as rows."""
    sizes = [4 * (1 + features), 6, boxes * 7, (boxes + heals) * 4]
    assert state.shape == (sum(sizes),)
    widths = [1 + features, 6, 7, 4]
    return [part.reshape(-1, k) for part, k in zip(np.split(state, np.cumsum(sizes)[:-1]), widths, strict=True)]


@pytest.mark.parametrize(("name", "features"), [("ffa_3", 8), ("teams_3", 9)])
def test_the_state_is_what_an_omniscient_observer_sees(name: str, features: int) -> None:
    env = outlast.parallel_env(name, **BUSY)
    seen = env.reset(seed=1)[0]["agent_0"]
    carried = broken = 0
    worlds = env.base_env.worlds
    for tick in range(scaled(100, least=20)):
        state = env.state()
        assert state.dtype == np.float32
        agents, zone, objects, items = blocks(state, features, 15, 8)
        assert np.array_equal(agents[0], [1, *seen["own"]])
        assert np.array_equal(agents[1:, 1:], seen["others"])
        assert np.array_equal(agents[1:, 0], seen["others_mask"])
        assert np.array_equal(zone[0], seen["zone"])
        width, height, place = seen["boxes"][:, 2], seen["boxes"][:, 5], seen["boxes"][:, 8:]
        expected = [seen["boxes_mask"], *place.T, width, height]
        assert np.array_equal(objects[:, :6], np.column_stack(expected))
        hits = worlds[Health].points[0, worlds.layout.rows(Box)]
        assert np.array_equal(objects[:, 6], hits * seen["boxes_mask"])
        shown = np.concatenate([seen["box_items"][:, 8:], seen["heals"]])
        mask = np.concatenate([seen["box_items_mask"], seen["heals_mask"]])
        assert np.array_equal(items[:, :3], np.column_stack([mask, shown]))
        first = worlds.span("box_item").start
        bags = [{row - first for row in bag[bag >= 0]} for bag in worlds[Bag].items[0, worlds.span("agent")]]
        assert [set(np.flatnonzero(items[:, 3] == 1 + i)) for i in range(4)] == bags
        carried, broken = max(carried, (items[:, 3] > 0).sum()), max(broken, (objects[:, 0] == 0).sum())
        seen = env.step(act(env, tick))[0]["agent_0"]
    assert carried > 1
    assert broken > 0


def test_the_dead_are_not_alive_in_the_state() -> None:
    env = short("ffa_3", dead="keep", seed=2)
    env.reset()
    dead = 0
    for _, (*_, infos) in play(env):
        rows = env.state()[: 4 * 9].reshape(4, 9)
        assert rows[:, 0].tolist() == [info["alive"] for info in infos.values()]
        assert not rows[rows[:, 0] == 0, 2:].any()
        dead += (rows[:, 0] == 0).sum()
    assert dead


def test_the_state_of_a_bare_scenario() -> None:
    """Without zone and items there are agents only."""
    bare = outlast.variant("ffa_1").without(SafeZone, Heals, Pickup, GiveLast, Inventory, "death_drop")
    overview = GlobalState(Worlds(bare.modules, 1))
    assert overview.space.shape == (2 * 9,)
    assert overview.space.contains(overview())


def test_the_state_has_walls_and_numbers() -> None:
    """Of the episode; walls that do not stand, and agents that are absent, are rows of 0."""
    env = short(ALL, dead="keep", seed=0)
    for _ in range(4):
        env.reset()
        worlds, state = env.base_env.worlds, env.state()
        numbers = ("agents_count", "boxes_count", "heals_count")
        assert state[-3:].tolist() == [env.base_env.numbers()[name][0] for name in numbers]
        rows = worlds.layout.rows(Wall)
        walls = state[-3 - 6 * len(rows) : -3].reshape(-1, 6)
        stand = worlds[Entity].alive[0, rows] != 0
        columns = [
            worlds[Body].x,
            worlds[Body].y,
            worlds[Body].angle,
            worlds[Shape].half_width,
            worlds[Shape].half_height,
        ]
        assert np.array_equal(walls[stand, 1:], np.stack([column[0, rows] for column in columns], 1)[stand])
        assert walls[:, 0].tolist() == stand.tolist()
        assert stand.sum() > 0
        assert not walls[~stand].any()
        agents = state[: 4 * (1 + worlds[SelfView].own.shape[-1])].reshape(4, -1)
        assert not agents[~present(worlds, 0)].any()
        assert env.state_space.contains(state)


# ---- saving


@both
@pytest.mark.parametrize("name", ["ffa_3", MAZE, ROLES])
def test_going_on_from_a_saved_state(name: str, dead: str) -> None:
    """In another environment, after a death; the state of one world of a batch will do as well."""
    env, other = short(name, dead=dead, seed=2), short(name, dead=dead, seed=77)
    _, infos = env.reset()
    while not env.agents or all(info["alive"] for info in infos.values()):
        *_, infos = env.step(act(env, 0)) if env.agents else env.reset()
    state, agents = env.get_state(), list(env.agents)
    assert len(agents) == 4 if dead == "keep" else 0 < len(agents) < 4
    expected = list(play(env))
    observations = other.set_state(state)
    assert list(observations) == other.agents == agents
    assert same(list(play(other)), expected)
    ended = env.get_state()
    env.reset()
    assert env.set_state(ended) == {}
    assert env.agents == []
    batch = outlast.make_vec(env.base_env.scenario, 3, seed=4)
    batch.reset()
    other.set_state(batch.get_state(2))
    own = batch.observe()["own"][2, 0]
    assert np.array_equal(other.state()[1 : 1 + len(own)], own)
