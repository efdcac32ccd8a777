"""Rooms of any rectangle: where walls stand and stop, who starts where, what is observed and drawn."""

import json

import numpy as np
import pytest

import outlast
from outlast import systems, variant
from outlast.components import Body, Zone
from outlast.ecs import NumberError, Worlds
from outlast.envs.rendering.rgb import draw, text
from outlast.envs.rendering.style import WALL
from outlast.envs.web.world_json import describe
from tests.conftest import digest, scaled
from tests.helpers.execution_modes import assert_played_alike

HALL = variant("ffa_1").replace(room_width=40.0, room_height=10.0, safe_zone_radii=(5.0, 2.0))


@pytest.mark.parametrize(("width", "height"), [(40.0, 0.0), (0.0, 40.0)])
def test_size_stands_for_the_side_that_is_not_given(width: float, height: float) -> None:
    room = systems.Room(size=25.0, width=width, height=height)
    assert room.sides() == (width or 25.0, height or 25.0)


def test_a_square_of_equal_sides_is_that_of_its_size() -> None:
    """To the bit, but for the second number of the floor."""
    square = variant("ffa_3").with_(systems.Room(width=25.0, height=25.0))
    one, two = assert_played_alike(variant("ffa_3"), square, scaled(200, least=3))
    assert digest(one.worlds) != digest(two.worlds)  # which has a longer state


def test_everybody_starts_in_the_cells_of_a_rectangle() -> None:
    env = outlast.make_vec(HALL, scaled(64, least=4), seed=0)
    env.reset()
    rows = env.worlds.span("heal")
    x, y = env.worlds[Body].x[:, rows], env.worlds[Body].y[:, rows]
    np.testing.assert_allclose(np.unique(x), 40 * ((np.arange(8) + 0.5) / 8 - 0.5), atol=1e-5)
    np.testing.assert_allclose(np.unique(y), 10 * ((np.arange(8) + 0.5) / 8 - 0.5), atol=1e-5)
    zone = env.worlds[Zone]
    assert (abs(zone.centres[:, 0, 0]) <= 15).all()
    assert (abs(zone.centres[:, 0, 1]) < 1e-5).all()  # the circle is as high as the room
    env.close()


@pytest.mark.parametrize(("axis", "angle"), [(0, 0.0), (1, np.pi / 2)])
def test_walls_stop_an_agent_and_put_back_who_is_beyond(axis: int, angle: float) -> None:
    env = outlast.make_vec(HALL.replace(safe_zone_damage=0), 1, seed=0)
    env.reset()
    body, edge = env.worlds[Body], (20.0, 5.0)[axis]
    place = (body.x, body.y)[axis]
    body.x[0, 0] = body.y[0, 0] = 0
    place[0, 0] = edge - 2
    body.angle[0, 0], body.cosine[0, 0], body.sine[0, 0] = angle, np.cos(angle), np.sin(angle)
    for _ in range(90):
        env.step(np.array([[[2, 1, 1, 0, 0, 0], [1, 1, 1, 0, 0, 0]]]))
    assert place[0, 0] == pytest.approx(edge * 0.99 - 0.505, abs=2e-3)
    place[0, 0] = edge + 3
    env.step(np.array([[[1, 1, 1, 0, 0, 0]] * 2]))
    assert place[0, 0] == pytest.approx(edge * 0.99 - 0.5, abs=1e-2)
    env.close()


def test_bounds_and_scales_are_those_of_the_sides() -> None:
    env = outlast.make_vec(HALL, 1, seed=0)
    own = env.single_observation_space["own"]
    assert (own.high[0, 2], own.high[0, 3]) == (20.0, 5.0)
    fields = env.worlds.layout.fields["own"]
    assert (fields["x"].scale, fields["y"].scale) == (20.0, 20.0)  # one scale: directions stay what they are
    env.close()


def test_rooms_that_cannot_be_are_refused() -> None:
    for numbers, words in (
        ({"room_width": 0.5}, "room.width = 0.5: at least 1 m"),
        ({"room_width": 40.0, "room_height": 10.0}, "room of side 10"),
    ):
        with pytest.raises(NumberError, match=words):
            Worlds(variant("ffa_1").replace(**numbers).modules, 1)


def test_rectangles_and_blocks_are_drawn() -> None:
    block = systems.Walls(layout=(5, 0, 6, 2, 0, 0))
    env = outlast.make_vec(HALL.without("safe_zone").with_(block), 1, seed=0)
    env.reset()
    image = draw(env.worlds, 0, 440)  # 10 pixels a metre: the room's longer side, and a tenth
    wall = (image == WALL).all(-1)
    assert wall[220, 270]  # the block
    assert not wall[220, 120:160].any()
    assert wall[140, 100]  # above the room
    lines = text(env.worlds, 0).splitlines()
    assert set(lines[1]) == {"|", "%"}
    assert lines[11].count("%") >= 5
    found = describe(env.worlds, 0)
    assert (found["room"], found["floor"]) == (40.0, [40.0, 10.0])
    assert next(each for each in found["objects"] if each["kind"] == "inner_wall")["role"] == "wall"
    json.dumps(found)
    env.close()
