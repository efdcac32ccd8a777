"""Entities that are placed by hand: all columns that follow from others are written, and slips are refused."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Body, Shape, Solid, Wall
from outlast.ecs import Entity
from outlast.errors import NotResetError

IDLE = (1, 1, 1, 0, 0, 0)


def made(scenario: Any = "teams_3", worlds: int = 3) -> Any:
    env = outlast.make_vec(scenario, worlds, seed=0)
    env.reset()
    return env


def test_all_that_follows_is_written_in_the_chosen_worlds() -> None:
    env = made()
    before = env.worlds.block.copy()
    row = env.place("box", 1, where=[0, 2], x=[2.0, -2.0], y=1.0, angle=0.5, half_width=0.4, half_height=0.3, density=2)
    body, shape, solid = (env.worlds[part] for part in (Body, Shape, Solid))
    assert row == env.worlds.span("box").start + 1
    assert body.x[[0, 2], row].tolist() == [2, -2]
    assert body.cosine[[0, 2], row] == pytest.approx(math.cos(0.5))
    assert body.sine[[0, 2], row] == pytest.approx(math.sin(0.5))
    assert shape.bound[[0, 2], row] == pytest.approx(0.5)
    assert solid.mass[[0, 2], row] == pytest.approx(2 * 0.8 * 0.6)
    assert solid.inertia[[0, 2], row] == pytest.approx(2 * 0.8 * 0.6 * (0.8**2 + 0.6**2) / 12)
    assert (env.worlds.block[1] == before[1]).all()


def test_what_is_placed_lives_at_rest_and_steps_go_on() -> None:
    env = made()
    env.place("agent", 0, x=-3, y=0, angle=0)
    for _ in range(10):
        env.step(np.tile((2, 1, 1, 0, 0, 0), (3, 4, 1)))
    row = env.place("agent", 0, x=0, y=0, angle=0, points=7)
    env.worlds[Entity].alive[:, row + 1] = 0
    env.place("agent", 1, x=1.5, y=0, angle=math.pi)
    env.step(np.tile(IDLE, (3, 4, 1)))
    assert env.worlds[Body].x[:, row].tolist() == [0, 0, 0]
    assert env.worlds[Entity].alive[:, row + 1].all()
    assert (env.observe()["own"][:, 0, list(env.fields["own"]).index("health")] == 7).all()


def test_a_wall_keeps_bodies_out_where_it_is_placed() -> None:
    env = made(outlast.variant("ffa_1").with_(systems.Walls(layout=(8, 8, 1, 1, 0, 0))))
    env.place("inner_wall", 0, x=2, y=0, angle=math.pi / 2, half_width=6, half_height=0.2)
    wall = env.worlds.span("inner_wall").start
    assert env.worlds[Wall].half_x[:, wall] == pytest.approx(0.2, abs=0.01)
    env.place("agent", 0, x=0, y=0, angle=0)
    for _ in range(100):
        env.step(np.tile((2, 1, 1, 0, 0, 0)[: len(env.action_sizes)], (3, 2, 1)))
    assert env.worlds[Body].x[:, 0] == pytest.approx(1.3, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "number", "values", "message"),
    [
        ("box", 99, {"x": 0}, "number = 99: there are"),
        ("box", 0, {"z": 0}, "the kind 'box' has no column 'z'; "),
        ("agent", 0, {"source": 0}, "'source' of the kind 'agent' could be 'Died.source' and 'Health.source'"),
        ("agent", 0, {"count": 1}, "Bag.count needs items: put items in"),
        ("agent", 0, {"points": 0.5}, "Health.points is int32, which cannot hold 0.5"),
    ],
)
def test_slips_are_refused_and_change_nothing(kind: str, number: int, values: dict[str, Any], message: str) -> None:
    env = made()
    before = env.worlds.block.copy()
    with pytest.raises(ValueError, match=message):
        env.place(kind, number, **{"x": 1} | values)
    assert (env.worlds.block == before).all()


def test_nothing_is_placed_before_a_reset_and_nobody_who_is_absent() -> None:
    env = outlast.make_vec("ffa_1", 1, seed=0)
    with pytest.raises(NotResetError):
        env.place("agent", x=0)
    fewer = made(outlast.variant("ffa_3").replace(n_agents=3).vary(n_agents=outlast.distributions.choice(2, 3)), 32)
    with pytest.raises(ValueError, match="agent 2 is absent in world"):
        fewer.place("agent", 2, x=0)
