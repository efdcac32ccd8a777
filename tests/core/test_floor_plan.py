"""Floor plans: from lists, text, files and worlds, and back; what cannot be is refused in words."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import FloorPlan, ScenarioError, systems, variant
from outlast.components import Body, Shape, Wall
from outlast.ecs import Entity
from tests.helpers.naive_walls import blocks

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
    """One rectangle for what is one; y grows upwards, and the middle of the text is the origin."""
    plan = FloorPlan.from_text(DRAWING, cell=2.0)
    assert (plan.width, plan.height) == (20.0, 12.0)
    sides = {(-9, -1, 2, 10, 0), (9, -1, 2, 10, 0)}
    assert set(plan.walls) == {(0, 5, 20, 2, 0), (0, -5, 16, 2, 0), (0, 0, 4, 4, 0), *sides}
    assert set(plan.starts) == {(0, -6, 2, 4, 4, 0), (1, 6, 2, 4, 4, 0), ("items", -6, -3, 4, 2, 0)}
    assert repr(plan) == "FloorPlan(5 walls, 3 start areas, 20 x 12 m)"


def test_drawn_cells_are_covered_once() -> None:
    """Random drawings: each cell of a wall is in exactly one rectangle, and no other is in any."""
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
    """The walls of a world that a generator drew, as data: they stand where they stood."""
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
    env.close()
    other.close()


def test_a_plan_in_a_room_of_its_size() -> None:
    plan = FloorPlan.from_text(DRAWING, cell=3.0)
    scenario = variant("teams_3").replace(safe_zone_radii=(8.0, 4.0), n_boxes=2, n_heals=4)
    env = outlast.make_vec(scenario.with_(plan.room(), plan.mechanic()), 4, seed=0)
    env.reset()
    body = env.worlds[Body]
    assert (body.x[:, :2] < -6).all()
    assert (body.x[:, 2:4] > 6).all()
    rows = env.worlds.layout.rows(Wall)
    assert env.worlds[Entity].alive[0, rows].sum() == 5
    assert env.worlds[Shape].half_width[0, rows].max() == 15
    env.close()


def test_layouts_of_one_length() -> None:
    assert len(PLAN.layout(10)) == 60
    assert PLAN.layout(10)[: 4 * 6] == PLAN.layout()
    with pytest.raises(ScenarioError, match="has 4 rectangles, more than 3"):
        PLAN.layout(3)
    with pytest.raises(ScenarioError, match="any size"):
        PLAN.room()


BAD: dict[str, tuple[Any, str]] = {
    "three numbers": (lambda: FloorPlan(walls=[(1, 2, 3)]), r"walls\[0\] has 3 numbers"),
    "no width": (lambda: FloorPlan(walls=[(1, 2, 0, 3)]), "must be above 0"),
    "NaN": (lambda: FloorPlan(walls=[(1, 2, math.nan, 3)]), "nan: a number"),
    "one side": (lambda: FloorPlan(width=40.0), "width = 40, height = 0: both are needed, or neither"),
    "text": (lambda: FloorPlan(walls="#"), "a list of rectangles"),
    "one rectangle": (lambda: FloorPlan(walls=(1, 2, 3, 4)), "a list of rectangles"),  # type: ignore[arg-type]
    "no owner": (lambda: FloorPlan(starts=[("heals", 1, 2, 3, 4)]), "the number of a side is needed"),
    "true": (lambda: FloorPlan(walls=[(1, 2, True, 3)]), "True: a number"),
    "too many": (lambda: FloorPlan(walls=[(0, 0, 1, 1)] * 451), "at most 450"),
    "a size": (lambda: FloorPlan(width=-1.0), "width = -1"),
    "a sign": (lambda: FloorPlan.from_text("..\n.x"), "line 2, column 2: 'x' means nothing"),
    "nothing": (lambda: FloorPlan.from_text("\n\n"), "0 x 0 characters"),
    "a cell": (lambda: FloorPlan.from_text("#", cell=0.0), "cell = 0.0"),
}


@pytest.mark.parametrize("name", BAD)
def test_plans_that_cannot_be_are_refused(name: str) -> None:
    make, words = BAD[name]
    with pytest.raises(ScenarioError, match=words):
        make()


GOOD = {"format": "outlast floor plan", "version": 1, "width": 0, "height": 0, "walls": [[0, 0, 1, 1]], "starts": []}
FILES: dict[str, tuple[str | bytes, str]] = {
    "another version": (json.dumps(GOOD | {"version": 2}), "version 2 .* reads version 1"),
    "no version": (json.dumps({k: v for k, v in GOOD.items() if k != "version"}), "version None"),
    "another format": (json.dumps(GOOD | {"format": "x"}), 'lacks "format"'),
    "another key": (json.dumps(GOOD | {"doors": []}), "it has 'doors'"),
    "a missing key": (json.dumps({k: v for k, v in GOOD.items() if k != "starts"}), "it lacks 'starts'"),
    "twice": ('{"format": "outlast floor plan", "format": "outlast floor plan"}', "it has 'format' twice"),
    "NaN": (json.dumps(GOOD | {"walls": [[math.nan, 0, 1, 1]]}), r"walls\[0\] has nan: a number"),
    "a large number": (json.dumps(GOOD | {"walls": [[1e300, 0, 1, 1]]}), "at most 10000"),
    "no list": (json.dumps(GOOD | {"walls": 7}), "a list of rectangles"),
    "an object": (json.dumps(GOOD | {"walls": {"a": 1}}), "a list of rectangles"),
    "nested": ("{" + '"a":[' * 5000, "is no floor plan"),
    "cut off": (json.dumps(GOOD)[:-5], "is no floor plan"),
    "bytes": (b"\xff\xfe\x00", "is no floor plan"),
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
