"""Tests of walls.py. Run it: python -m pytest docs/examples/test_walls.py."""

import numpy as np
import pytest
from walls import HOUSE, House

import outlast
from outlast.components import Body, Shape, Sight
from outlast.components.sight import is_set
from outlast.ecs import NumberError

IDLE, AHEAD = (1, 1, 1, 0, 0, 0), (2, 1, 1, 0, 0, 0)


def placed(x, y):
    """One world: agent 0 stands at (x, -3) and looks north, agent 2 at (x, 3), behind the wall or the door."""
    env = outlast.make_vec(HOUSE, 1, seed=0, safe_zone_damage=0)
    env.reset()
    body = env.worlds[Body]
    body.x[0, :4], body.y[0, :4] = (x, 10, x, -10), (-3, 10, y, 10)
    body.angle[0, 0], body.cosine[0, 0], body.sine[0, 0] = np.pi / 2, 0, 1
    return env


def step(env, first):
    return env.step(np.array([[first, IDLE, IDLE, IDLE]]))


def test_there_is_a_door_between_any_two_rooms():
    pieces = np.array(House(size=24.0, rooms=3, door=2.0).pieces())
    lying = pieces[pieces[:, 2] > pieces[:, 3]]
    assert len(pieces) == 2 * len(lying) == 2 * 2 * 4
    assert set(lying[:, 1]) == {-4, 4}
    assert lying[lying[:, 1] == 4][:, 2].sum() * 2 == pytest.approx(24 - 3 * 2)


def test_nobody_starts_in_a_wall():
    env = outlast.make_vec(HOUSE, 64, seed=0, house_rooms=4)
    env.reset()
    body, shape, walls = env.worlds[Body], env.worlds[Shape], env.worlds.span("inner_wall")
    for rows in (env.worlds.span("agent"), env.worlds.span("heal")):
        for w in range(walls.start, walls.stop):
            apart_x = abs(body.x[:, rows] - body.x[:, [w]]) - shape.half_width[:, [w]]
            apart_y = abs(body.y[:, rows] - body.y[:, [w]]) - shape.half_height[:, [w]]
            assert (np.maximum(apart_x, apart_y) > shape.radius[:, rows]).all()


@pytest.mark.parametrize(("x", "through"), [(-6.25, True), (-3.0, False)])
def test_one_gets_through_the_door_and_not_through_the_wall(x, through):
    env = placed(x, 10)
    for _ in range(60):
        step(env, AHEAD)
    assert (env.worlds[Body].y[0, 0] > 1) == through


@pytest.mark.parametrize(("x", "seen"), [(-6.25, True), (-3.0, False)])
def test_a_wall_hides_what_is_behind_it(x, seen):
    env = placed(x, 3)
    step(env, IDLE)
    assert bool(is_set(env.worlds[Sight].visible[0], 0, 2)) == seen


def test_impossible_houses_are_refused():
    with pytest.raises(NumberError, match=r"house.rooms = 3 does not divide spawn_grid.cells = 8.* spawn_grid_cells=9"):
        outlast.make_vec(HOUSE, 1, house_rooms=3)
    with pytest.raises(NumberError, match=r"a room is only 12.5 metres wide"):
        outlast.make_vec(HOUSE, 1, house_door=13.0)
