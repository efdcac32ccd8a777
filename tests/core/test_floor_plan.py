"""Floor plans: from lists, text, files and worlds, and back; their parts; what cannot be is refused in words."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems, variant
from outlast.components import Body
from outlast.errors import ScenarioError
from outlast.levels import FloorPlan
from tests.conftest import run, scaled
from tests.helpers.naive_walls import blocks, free_parts, signed_distance

DRAWING = """
##########
#AA....BB#
#AA.##.BB#
#...##...#
#**......#
##########
"""
PLAN = FloorPlan(walls=[(0, 0, 6, 0.4), (1, 2, 3, 0.5, 0.7)], starts=[(0, -8, 0, 4, 8), ("items", 8, 0, 4, 8)])


def test_a_drawing() -> None:
    plan = FloorPlan.from_text(DRAWING, cell=2.0)
    assert (plan.width, plan.height) == (20.0, 12.0)
    sides = {(-9, -1, 2, 10, 0), (9, -1, 2, 10, 0)}
    assert set(plan.walls) == {(0, 5, 20, 2, 0), (0, -5, 16, 2, 0), (0, 0, 4, 4, 0), *sides}
    assert set(plan.starts) == {(0, -6, 2, 4, 4, 0), (1, 6, 2, 4, 4, 0), ("items", -6, -3, 4, 2, 0)}
    assert repr(plan) == "FloorPlan(5 walls, 3 start areas, 20 x 12 m)"


def test_drawn_cells_are_covered_once() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        grid = rng.random((7, 9)) < 0.5
        grid[[0, -1], -1] = True  # no line is blank at the ends, nor is the last column
        plan = FloorPlan.from_text("\n".join("".join("#" if cell else "." for cell in row) for row in grid) + "\n")
        rows, columns = int(plan.height), int(plan.width)
        covered = np.zeros((rows, columns), int)
        for x, y, width, height, _ in plan.walls:
            left, top = round(x - width / 2 + columns / 2), round(rows / 2 - y - height / 2)
            covered[top : top + round(height), left : left + round(width)] += 1
        np.testing.assert_array_equal(covered, grid)


def test_a_file_keeps_everything(tmp_path: Path) -> None:
    plan = FloorPlan(PLAN.walls, PLAN.starts, 30.0, 20.0)
    plan.save(tmp_path / "plan.json")
    assert FloorPlan.load(tmp_path / "plan.json") == plan
    (tmp_path / "plan.txt").write_text(DRAWING)
    assert FloorPlan.load(tmp_path / "plan.txt") == FloorPlan.from_text(DRAWING)
    assert {path.name for path in tmp_path.iterdir()} == {"plan.json", "plan.txt"}


def test_a_world_as_a_plan_is_set_up_again() -> None:
    env = outlast.make_vec(variant("ffa_1").with_(systems.Pillars()), 3, seed=0)
    env.reset()
    plan = FloorPlan.of_world(env.worlds, 2)
    assert (len(plan.walls), plan.width, plan.height) == (12, 25.0, 25.0)
    other = outlast.make_vec(variant("ffa_1").with_(plan.mechanic()), 1, seed=5)
    other.reset()
    assert blocks(other.worlds, 0) == blocks(env.worlds, 2)
    for strange in (3, -1, 1.0, "x"):
        with pytest.raises(ScenarioError, match=f"world {strange!r}: there are the worlds 0 to 2"):
            FloorPlan.of_world(env.worlds, strange)


def test_kinds_start_in_areas_of_their_own() -> None:
    plan = FloorPlan.from_text("AA..#..hh\nAA..#..hh\n....#....\nbb.....BB\nbb..#..BB", 4.0, {"h": "heal", "b": "box"})
    scenario = variant("teams_3").replace(safe_zone_radii=(8.0, 4.0), n_boxes=2, n_heals=3)
    env = outlast.make_vec(scenario.with_(plan.room(), plan.mechanic()), 16, seed=0)
    env.reset()
    body, span = env.worlds[Body], env.worlds.span
    assert (np.abs(body.x[:, span("heal")] - 14) <= 4).all()
    assert (np.abs(body.y[:, span("heal")] - 6) <= 4).all()
    assert (np.abs(body.x[:, span("box")] + 14) <= 4).all()
    assert (np.abs(body.y[:, span("box")] + 6) <= 4).all()
    assert (body.x[:, 2:4] >= 10).all()
    with pytest.raises(
        outlast.ecs.NumberError, match=r"for a kind that does not spawn here.*a kind that spawns: agent"
    ):
        outlast.make_vec(scenario.without("heals").with_(plan.room(), plan.mechanic()), 1)
    with pytest.raises(ScenarioError, match="kinds has 'A': signs are single characters"):
        FloorPlan.from_text("A", kinds={"A": "box"})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FloorPlan(walls=[(1, 2, 3)]), r"walls\[0\] has 3 numbers"),
        (lambda: FloorPlan(walls=[(1, 2, 0, 3)]), "must be above 0"),
        (lambda: FloorPlan(walls=[(1, 2, math.nan, 3)]), "nan: a number"),
        (lambda: FloorPlan(width=40.0), "width = 40, height = 0: both are needed, or neither"),
        (lambda: FloorPlan(walls="#"), "a list of rectangles"),
        (lambda: FloorPlan(walls=[(0, 0, 1, 1)] * 451), "at most 450"),
        (lambda: FloorPlan(starts=[("a heal", 1, 2, 3, 4)]), "the number of a side is needed"),
        (lambda: FloorPlan.from_text("..\n.x"), "line 2, column 2: 'x' means nothing"),
        (lambda: FloorPlan.from_text("\n\n"), "0 x 0 characters"),
        (lambda: FloorPlan.from_text("#", cell=0.0), "cell = 0.0"),
        (lambda: PLAN.layout(3), "has 4 rectangles, more than 3"),
        (PLAN.room, "any size"),
        (lambda: FloorPlan().parts(1.0), r"width and height are needed, as in parts\(1.0, room=\(25, 25\)\)"),
        (lambda: FloorPlan().parts(1.0, (3,)), r"in a room of \(3,\): width and height"),
        (lambda: FloorPlan().parts(0.0, (20, 20)), "a diameter from a 500th of the floor's longer side on is needed"),
        (lambda: FloorPlan().parts(math.nan, (20, 20)), "parts has nan: a number"),
    ],
)
def test_plans_that_cannot_be_are_refused(make: Any, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        make()


GOOD = {"format": "outlast floor plan", "version": 1, "width": 0, "height": 0, "walls": [[0, 0, 1, 1]], "starts": []}
FILES: dict[str, tuple[str | bytes, str]] = {
    "another key": (json.dumps(GOOD | {"doors": []}), "it has 'doors'"),
    "twice": ('{"format": "outlast floor plan", "format": "outlast floor plan"}', "it has 'format' twice"),
    "a large number": (json.dumps(GOOD | {"walls": [[1e300, 0, 1, 1]]}), "at most 10000"),
    "large": (b"#" * (2**20 + 1), "more than 1,048,576 bytes"),
    "a long line": ("#" * 2000, "1 to 1000 either way"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_no_plans_are_refused(name: str, tmp_path: Path) -> None:
    content, words = FILES[name]
    path = tmp_path / "plan.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ScenarioError, match=words):
        FloorPlan.load(path)


SPLIT = """
AA....#....BB
AA....#....BB
......#......
###...#......
*.#...#......
"""


@pytest.mark.parametrize("mechanic", [systems.Maze(), systems.Rooms(doors=0.0), systems.Pillars()])
def test_what_is_drawn_is_one_part_for_agents_and_several_for_who_is_wider(mechanic: Any) -> None:
    env = outlast.make_vec(variant("ffa_1").with_(mechanic), scaled(3), seed=0)
    env.reset()
    for w in range(env.num_worlds):
        plan = FloorPlan.of_world(env.worlds, w)
        (part,) = plan.parts(1.0, room=(24.75, 24.75))
        assert all(signed_distance(block, part.x, part.y) > 0.5 for block in blocks(env.worlds, w))
        naive = free_parts(env.worlds, w, 0.5, step=0.1)
        assert part.area == pytest.approx(naive[0] * 0.01, rel=0.02)
        if not isinstance(mechanic, systems.Pillars):
            assert len(plan.parts(4.0, room=(24.75, 24.75))) > 1


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, 1.2])
@pytest.mark.parametrize(("door", "parts"), [(0.99, 2), (1.11, 1), (2.0, 1)])
def test_a_door_counts_if_the_disc_gets_through(angle: float, door: float, parts: int) -> None:
    turn = complex(math.cos(angle), math.sin(angle))
    for middle in np.linspace(-0.3, 0.3, 7):
        ends = (
            ((middle + door / 2 + 20) / 2, 20 - middle - door / 2),
            ((middle - door / 2 - 20) / 2, middle - door / 2 + 20),
        )
        walls = [((turn * 1j * y).real, (turn * 1j * y).imag, 0.4, length, angle) for y, length in ends]
        assert len(FloorPlan(walls=walls).parts(1.0, room=(20.0, 20.0))) == parts


def test_the_command_warns_of_parts(capsys: Any, tmp_path: Path) -> None:
    (tmp_path / "split.txt").write_text(SPLIT.replace("*", "."))
    (tmp_path / "one.txt").write_text("AA....#....BB\n" * 4 + "AA.........BB\n" * 2)
    game = ("--variant", "teams_3", "--set", "safe_zone_radii=2,1", "--set", "n_heals=2", "--set", "n_boxes=1")
    game += ("--set", "agents_radius=0.3")
    for name, warned in ((tmp_path / "split.txt", True), (tmp_path / "one.txt", False), ("rooms", False)):
        status, _, err = run(capsys, "layout", name, *(game if name != "rooms" else ()), "--out", tmp_path / "a.png")
        assert status == 0, err
        assert ("cannot get from one part of the floor to another" in err) == warned, err
        if warned:
            assert "agents 0.6 m wide" in err
            assert "where side 1 start; " in err
            assert err.count("square metres around") == 3
            lines = [line for line in err.splitlines() if "compil" not in line]  # which it may do here
            assert len(lines) == 1
