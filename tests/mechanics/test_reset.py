"""How an episode begins, draw by draw: cells, boxes and zones against numpy's own Philox."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Guard, Shape, Side, Spawned
from outlast.ecs import NumberError
from tests.conftest import scaled
from tests.helpers.naive_world import TOLERANCE, World, read
from tests.helpers.random_worlds import RUNS
from tests.reference.random_numbers import draw_index, philox, uniform2

COUNT = scaled(40, least=3)
CASES = {
    "as run": ("teams_4", RUNS),
    "paper": ("ffa_1", {}),
    "every cell is taken": ("ffa_4", {"n_agents": 9, "n_boxes": 7, "n_heals": 9, "spawn_grid_cells": 5}),
    "boxes of one size, zones in the middle": ("teams_3", {
        "boxes_width_deviation": 0.0, "boxes_height_deviation": 0.0, "safe_zone_centres": "middle",
        "safe_zone_radii": (3.0,),
    }),
    "nearly all boxes as small as can be": ("ffa_3", {"boxes_width": 0.004, "boxes_least": 0.003}),
}  # fmt: skip


def fresh(name: str) -> list[World]:
    """Worlds in their second episode, as reset leaves them."""
    variant, numbers = CASES[name]
    env = outlast.make_vec(outlast.variant(variant).replace(**numbers), COUNT, seed=2**63 + 11, first_world=5)
    env.reset()
    env.reset()
    worlds = [read(env, w) for w in range(COUNT)]
    env.close()
    return worlds


def cells(world: World) -> list[tuple[float, float]]:
    """Centres for agents, boxes and heals in this order: each draws one of the cells that are left."""
    side, size = world.numbers["spawn_grid_cells"], world.numbers["room_size"]
    left, places = list(range(side**2)), []
    for k, entity in enumerate(world.of("agent", "box", "heal")):
        pick = k + (philox(world, "spawn.place", draw_index(entity))[0] * (side**2 - k) >> 64)
        left[k], left[pick] = left[pick], left[k]
        places.append(tuple(size * ((index + 0.5) / side - 0.5) for index in (left[k] % side, left[k] // side)))
    return places


def normal(world: World, index: int) -> float:
    """Box and Muller's, of the first two words."""
    first, second, *_ = philox(world, "boxes.shape_boxes", index)
    distance, turn = ((first >> 11) + 1) / 2**53, (second >> 11) / 2**53
    return math.sqrt(-2 * math.log(distance)) * math.cos(2 * math.pi * turn)


@pytest.mark.parametrize("name", CASES)
def test_every_entity_gets_the_cell_that_the_random_numbers_give(name: str) -> None:
    for world in fresh(name):
        got = [(entity.x, entity.y) for entity in world.of("agent", "box", "heal")]
        assert got == [pytest.approx(place, abs=TOLERANCE) for place in cells(world)]
        assert {(e.here, e.angle, e.vx, e.vy, e.omega) for e in world.of("agent", "box", "heal")} == {(1, 0, 0, 0, 0)}
        assert world.key[2] == 2


@pytest.mark.parametrize("name", [name for name in CASES if name != "paper"])
def test_boxes_have_the_sides_that_the_random_numbers_give(name: str) -> None:
    for world in fresh(name):
        numbers = world.numbers
        for k, box in enumerate(world.of("box")):
            for half, side, index in ((box.half_width, "width", 2 * k), (box.half_height, "height", 2 * k + 1)):
                drawn = numbers[f"boxes_{side}"] + numbers[f"boxes_{side}_deviation"] * normal(world, index)
                assert 2 * half == pytest.approx(max(numbers["boxes_least"], drawn), abs=TOLERANCE)


@pytest.mark.parametrize("name", CASES)
def test_zones_have_the_centres_that_the_random_numbers_give(name: str) -> None:
    for world in fresh(name):
        radii = [*world.numbers["safe_zone_radii"], 0.0]
        for k, (centre, radius) in enumerate(zip(world.centres, radii, strict=True)):
            room = world.numbers["room_size"] - 2 * radius if world.numbers["safe_zone_centres"] == "random" else 0.0
            drawn = [room * (share - 0.5) for share in uniform2(world, "zone.draw", k)]
            assert centre == pytest.approx(tuple(drawn), abs=TOLERANCE)


@pytest.mark.parametrize("agents", [1, 2, 3, 7, 8])
def test_sides_are_teams_of_nearly_equal_size_or_single_agents(agents: int) -> None:
    for teams in [None, *range(1, min(agents, 4) + 1)]:
        scenario = outlast.variant("ffa_1" if teams is None else "teams_2")
        counts = {"n_agents": agents} | ({} if teams is None else {"teams_count": teams})
        env = outlast.make_vec(scenario.replace(**counts), 1, seed=0)
        env.reset()
        span = env.worlds.span("agent")
        sides, immune_to = (column[0, span].tolist() for column in (env.worlds[Side].side, env.worlds[Guard].immune_to))
        if teams is None:
            assert (sides, immune_to) == (list(range(agents)), [-1] * agents)
        else:
            sizes = [sides.count(side) for side in range(teams)]
            assert sides == immune_to == sorted(sides)
            assert sizes == [agents // teams] * (teams - agents % teams) + [agents // teams + 1] * (agents % teams)


HALL = {"room_width": 40.0, "room_height": 10.0, "safe_zone_radii": (5.0, 2.0)}


@pytest.mark.parametrize(
    "numbers", [{}, {"room_size": 40.0, "room_thickness": 0.1}, HALL], ids=["paper", "larger", "hall"]
)
def test_walls_stand_astride_the_edges_and_meet_in_the_corners(numbers: dict[str, Any]) -> None:
    """As long as the floor, and in the paper a hundredth of it thick (reference rules, section 1)."""
    env = outlast.make_vec(outlast.variant("ffa_1").replace(**numbers), 1, seed=0)
    env.reset()
    span, (body, shape) = env.worlds.span("wall"), (env.worlds[Body], env.worlds[Shape])
    columns = (body.x, body.y, shape.half_width, shape.half_height)
    walls = [tuple(round(float(column[0, e]), 6) for column in columns) for e in range(span.start, span.stop)]
    x, y = (numbers.get(name, numbers.get("room_size", 25.0)) / 2 for name in ("room_width", "room_height"))
    thin, flat = (side * numbers.get("room_thickness", 0.01) for side in (x, y))
    assert sorted(walls) == sorted([(x, 0, thin, y), (-x, 0, thin, y), (0, y, x, flat), (0, -y, x, flat)])


def test_nobody_starts_in_a_thick_wall() -> None:
    thick = outlast.variant("ffa_1").replace(room_thickness=0.125)
    env = outlast.make_vec(thick, COUNT, seed=0)
    env.reset()
    middles, inside = env.worlds[Body], 12.5 * (1 - 0.125)
    spawned = env.worlds.layout.rows(Spawned)
    assert np.abs(np.stack([middles.x[:, spawned], middles.y[:, spawned]])).max() <= inside
    with pytest.raises(NumberError, match=r"walls would cover the middles .* = 8; take at most 0.125"):
        outlast.make_vec(thick.replace(room_thickness=0.13), 1)
    outlast.make_vec(thick.replace(room_thickness=0.13, room_walls=False), 1).close()
