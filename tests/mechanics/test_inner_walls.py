"""Walls inside of the room: generators connect, everybody starts in a free place, and nobody gets through."""

import itertools
import math

import numpy as np
import pytest

import outlast
from outlast import systems, variant
from outlast.components import Body, Side, Spawned
from outlast.ecs import Entity
from tests.conftest import COMPILED, few_by_day, scaled
from tests.helpers.execution_modes import assert_played_alike
from tests.helpers.naive_walls import blocks, free_parts, level, obstacles, signed_distance
from tests.helpers.random_levels import LevelChecker

GENERATORS: dict[str, systems.Maze | systems.Rooms | systems.Pillars] = {
    "maze": systems.Maze(),
    "maze without loops": systems.Maze(columns=5, rows=7, loops=0.0),
    "rooms": systems.Rooms(),
    "narrow doors": systems.Rooms(columns=4, rows=3, doors=0.0, door=1.1, thickness=0.2),
    "pillars": systems.Pillars(),
    "many pillars": systems.Pillars(count=30, least=0.4, most=0.9, gap=1.1),
}
generators = pytest.mark.parametrize("kind", few_by_day(GENERATORS, ("maze", "narrow doors", "many pillars")))


@generators
def test_floor_is_connected_and_doors_are_passable(kind: str) -> None:
    """Where an agent can be is one part: a flood fill of floor for its radius."""
    env = outlast.make_vec(variant("ffa_1").with_(GENERATORS[kind]), scaled(2), seed=7)
    env.reset()
    for w in range(env.num_worlds):
        parts = free_parts(env.worlds, w, 0.5)
        assert len(parts) == 1, parts
    env.close()


@generators
def test_blocks_are_as_many_as_their_numbers_say(kind: str) -> None:
    mechanic = GENERATORS[kind]
    env = outlast.make_vec(variant("ffa_1").with_(mechanic), scaled(200, least=4), seed=7)
    env.reset()
    counts = env.worlds[Entity].alive[:, env.worlds.span("inner_wall")].sum(1)
    if isinstance(mechanic, systems.Pillars):
        assert (counts == mechanic.count).all()
    else:
        edges = (mechanic.columns - 1) * mechanic.rows + mechanic.columns * (mechanic.rows - 1)
        tree = mechanic.columns * mechanic.rows - 1  # openings that connect all cells
        extra = mechanic.loops if isinstance(mechanic, systems.Maze) else mechanic.doors
        openings = edges - counts if isinstance(mechanic, systems.Maze) else counts - edges
        assert (openings >= tree).all()
        share = (openings - tree).mean() / (edges - tree)
        assert share == extra if extra in (0, 1) else not COMPILED or abs(share - extra) < 0.06
    assert len({env.worlds[Body].x[w].tobytes() for w in range(env.num_worlds)}) == env.num_worlds
    env.close()


def test_pillars_leave_gaps() -> None:
    mechanic = GENERATORS["many pillars"]
    env = outlast.make_vec(variant("ffa_1").with_(mechanic), scaled(20, least=2), seed=1)
    env.reset()
    for w in range(env.num_worlds):
        pillars = blocks(env.worlds, w)
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
    scenario = variant("ffa_1").replace(safe_zone_damage=0).with_(level((0, 0, 0.1, 20, 0, 0)))
    env = outlast.make_vec(scenario, 1, seed=0)
    env.reset()
    body = env.worlds[Body]
    env.place("agent", 0, x=-0.6, y=0, angle=0)
    body.vx[0, 0], body.vy[0, 0] = 40.0, 1.0  # metres a second: 1.3 m in a tick
    env.step(np.tile(env.noop, (1, 2, 1)))
    assert body.x[0, 0] < -0.05
    assert body.y[0, 0] > 0.01


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


def test_without_blocks_nothing_changes_but_overlaps_at_the_start() -> None:
    """The numbers that are drawn, and who starts where, are the same as without the mechanic."""
    assert_played_alike(variant("ffa_1"), variant("ffa_1").with_(systems.Walls()), scaled(100, least=2))


def test_a_single_room_has_no_inner_walls() -> None:
    for mechanic in (systems.Maze(columns=1), systems.Rooms(columns=1, rows=1)):
        env = outlast.make_vec(variant("ffa_1").with_(systems.Maze()).with_(mechanic), 1, seed=0)
        env.reset()
        assert not env.worlds[Entity].alive[:, env.worlds.span("inner_wall")].any()
