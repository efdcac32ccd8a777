"""Walls inside of the room: generators connect, everybody starts in a free place, and nobody gets through."""

import itertools
import math

import numpy as np
import pytest

import outlast
from outlast import systems, variant
from outlast.components import Body, Floor, Health, Side, Spawned
from outlast.ecs import Entity
from tests.conftest import few_by_day, scaled
from tests.helpers.execution_modes import assert_played_alike
from tests.helpers.naive_walls import blocks, cell_walls, level, obstacles, signed_distance
from tests.helpers.random_levels import LevelChecker
from tests.reference.random_numbers import keyed, name_hash

MAZES: dict[str, systems.Maze | systems.Rooms] = {
    "maze": systems.Maze(),
    "maze without loops": systems.Maze(columns=5, rows=7, loops=0.0),
    "rooms": systems.Rooms(),
    "narrow doors": systems.Rooms(columns=4, rows=3, doors=0.0, door=1.1, thickness=0.2),
}
OBLONG = {"room_width": 31.0, "room_height": 24.0, "safe_zone_radii": (11.0, 5.0)}
ONE_WALL = variant("ffa_1").replace(safe_zone_damage=0, melee_blocked=False).with_(level((0, 0, 0.1, 20, 0, 0)))


@pytest.mark.parametrize("kind", few_by_day(MAZES, ("maze", "narrow doors")))
def test_mazes_and_rooms_are_those_of_the_naive_form(kind: str) -> None:
    game = variant("ffa_1").replace(**OBLONG if kind == "narrow doors" else {}).with_(MAZES[kind])
    env = outlast.make_vec(game, scaled(200, least=4), seed=7)
    env.reset()
    for w in range(env.num_worlds):
        found = [(block.x, block.y, block.half_width, block.half_height) for block in blocks(env.worlds, w)]
        np.testing.assert_allclose(found, cell_walls(MAZES[kind], env.worlds[Floor].size[w], (7, w, 1)), atol=1e-5)
    env.close()


def test_pillars_leave_gaps() -> None:
    mechanic = systems.Pillars(count=30, least=0.4, most=0.9, gap=1.1)
    env = outlast.make_vec(variant("ffa_1").with_(mechanic), scaled(20, least=2), seed=1)
    env.reset()
    for w in range(env.num_worlds):
        pillars = blocks(env.worlds, w)
        assert len(pillars) == mechanic.count
        for one, two in itertools.combinations(pillars, 2):
            far = math.hypot(one.x - two.x, one.y - two.y) - math.sqrt(2) * (one.half_width + two.half_width)
            assert far > mechanic.gap - 1e-4
        for pillar in pillars:
            walls = [wall for wall in obstacles(env.worlds, w) if wall not in pillars]
            gap = min(float(signed_distance(wall, pillar.x, pillar.y)) for wall in walls)
            assert gap - math.sqrt(2) * pillar.half_width > mechanic.gap - 1e-4
    env.close()


def test_a_body_that_is_pushed_through_a_thin_wall_stays_on_its_side() -> None:
    """Moved by hand before contacts are resolved, as no play does; along the wall it moves freely."""
    env = outlast.make_vec(ONE_WALL, 1, seed=0)
    env.reset()
    body = env.worlds[Body]
    env.place("agent", 0, x=-0.6, y=0, angle=0)
    body.vx[0, 0], body.vy[0, 0] = 40.0, 1.0  # metres a second: 1.3 m in a tick
    env.step(np.tile(env.noop, (1, 2, 1)))
    assert body.x[0, 0] < -0.05
    assert body.y[0, 0] > 0.01


@pytest.mark.parametrize("heading", [0.0, 0.6, -0.9, 2.8, -2.4])
@pytest.mark.parametrize("away", [0, 3])
def test_strikes_end_at_a_wall_that_is_between(heading: float, away: float) -> None:
    """Two agents face each other across a thin wall, or 3 m away from it."""
    env = outlast.make_vec(ONE_WALL, 1, seed=0)
    env.reset()
    x, y = 0.8 * math.cos(heading), 0.8 * math.sin(heading)
    env.place("agent", 0, x=away - x, y=-y, angle=heading)
    env.place("agent", 1, x=away + x, y=y, angle=heading + math.pi)
    before = env.worlds[Health].points[0, :2].copy()
    env.step(np.array([[[1, 1, 1, 1, 0, 0]] * 2]))
    assert (env.worlds[Health].points[0, :2] == before - (5 if away else 0)).all()


def test_start_areas_are_kept() -> None:
    areas = level((-9, 0, 4, 12, 0, 1), (9, 2, 4, 10, 0.3, 2), (0, 8, 14, 5, 0, -1))  # that of items reaches into one
    env = outlast.make_vec(variant("teams_3").with_(areas), scaled(32, least=2), seed=0)
    env.reset()
    body, side = env.worlds[Body], env.worlds[Side].side
    for e in env.worlds.layout.rows(Spawned).tolist():
        for w in range(env.num_worlds):
            x, y, angle = (-9, 0, 0.0) if side[w, e] == 0 else (9, 2, 0.3)
            half_width, half_height = (2, 6) if side[w, e] == 0 else (2, 5)
            if e >= env.num_agents:
                x, y, angle, half_width, half_height = 0, 8, 0.0, 7, 2.5
            local = complex(body.x[w, e] - x, body.y[w, e] - y) * complex(math.cos(angle), -math.sin(angle))
            assert abs(local.real) <= half_width + 1e-4
            assert abs(local.imag) <= half_height + 1e-4
    LevelChecker(env, 0).check()
    env.close()


def test_places_that_random_draws_miss_are_found_on_a_lattice() -> None:
    """The only free floor of an area is a slot for one agent; the first of its points is at random, too."""
    slot = level((0, 0, 10, 10, 0, 1), (-0.8525, 0, 10.295, 10, 0, 0), (5.925, 0, 1, 10, 0, 0))
    env = outlast.make_vec(variant("teams_3").with_(slot), scaled(200, least=20), seed=0)
    env.reset()
    index, stepped = (name_hash("agent") >> 33 << 32) + (64 << 20), 0
    for w, (x, y) in enumerate(zip(env.worlds[Body].x[:, 0].tolist(), env.worlds[Body].y[:, 0].tolist(), strict=True)):
        assert abs(x - 4.86) < 0.0451
        if abs(x - 4.875) < 1e-6:  # the last column of the lattice, and the only one in the slot
            first = int((keyed((0, w, 1), 0, "inner_walls.find_places", index)[0] >> 40) / 2**24 * 4 * 1600)
            row = next((row for row in range(first // 40, 40) if 40 * row + 39 >= first), 0)
            assert y == pytest.approx((row + 0.5) / 4 - 5, abs=1e-5)
            stepped += row > 0
    env.close()
    assert stepped > env.num_worlds / 20


def test_without_blocks_nothing_changes_but_overlaps_at_the_start() -> None:
    """The numbers that are drawn, and who starts where, are the same as without the mechanic."""
    assert_played_alike(variant("ffa_1"), variant("ffa_1").with_(systems.Walls()), scaled(100, least=2))


def test_a_single_room_has_no_inner_walls() -> None:
    for mechanic in (systems.Maze(columns=1), systems.Rooms(columns=1, rows=1)):
        env = outlast.make_vec(variant("ffa_1").with_(systems.Maze()).with_(mechanic), 1, seed=0)
        env.reset()
        assert not env.worlds[Entity].alive[:, env.worlds.span("inner_wall")].any()
