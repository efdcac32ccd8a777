"""Parts of a floor plan: a flood fill by another rule finds the same; doors count from their width on."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import FloorPlan, ScenarioError, systems, variant
from outlast.systems.geometry.plans import connected
from tests.conftest import run, scaled
from tests.helpers.naive_walls import blocks, free_parts, signed_distance

SPLIT = """
AA....#....BB
AA....#....BB
......#......
###...#......
*.#...#......
"""


def flooded(free: Any) -> list[set[tuple[int, int]]]:
    """The parts of a lattice by a walk from point to point."""
    left, found = {(int(i), int(j)) for i, j in zip(*np.nonzero(free), strict=True)}, []
    while left:
        waiting, part = [left.pop()], set[tuple[int, int]]()
        while waiting:
            i, j = waiting.pop()
            part.add((i, j))
            near = {(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)} & left
            left -= near
            waiting += near
        found.append(part)
    return found


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6, 1.0])
def test_points_that_are_connected_have_one_number(share: float) -> None:
    rng = np.random.default_rng(0)
    for rows, columns in ((1, 1), (1, 9), (9, 1), (30, 40), (60, 7)):
        free = rng.random((rows, columns)) < share
        labels, parts = connected(free), flooded(free)
        assert labels.max() == len(parts)
        assert not labels[~free].any()
        for part in parts:
            assert len({int(labels[i, j]) for i, j in part}) == 1


@pytest.mark.parametrize("mechanic", [systems.Maze(), systems.Rooms(doors=0.0), systems.Pillars()])
def test_what_is_drawn_is_one_part_for_agents_and_several_for_who_is_wider(mechanic: Any) -> None:
    """Of the same size as those of the naive flood fill, which the walls of the world decide, too."""
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
    env.close()


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, 1.2])
@pytest.mark.parametrize(("door", "parts"), [(0.99, 2), (1.11, 1), (2.0, 1)])
def test_a_door_counts_if_the_disc_gets_through(angle: float, door: float, parts: int) -> None:
    """Wherever it is, and whichever way its wall stands; between the two it is not said."""
    turn = complex(math.cos(angle), math.sin(angle))
    for middle in np.linspace(-0.3, 0.3, 7):
        ends = (
            ((middle + door / 2 + 20) / 2, 20 - middle - door / 2),
            ((middle - door / 2 - 20) / 2, middle - door / 2 + 20),
        )
        walls = [((turn * 1j * y).real, (turn * 1j * y).imag, 0.4, length, angle) for y, length in ends]
        assert len(FloorPlan(walls=walls).parts(1.0, room=(20.0, 20.0))) == parts


def test_parts_say_where_they_are_and_who_starts_there() -> None:
    plan = FloorPlan.from_text(SPLIT, cell=2.0)
    one, two, pocket = plan.parts(1.0)
    owners = [owner for owner, *_ in plan.starts]
    assert [[owners[k] for k in part.starts] for part in (one, two, pocket)] == [[1], [0], ["items"]]
    assert one.x > 0 > two.x > pocket.x
    assert one.area == pytest.approx(11 * 9)
    assert pocket.area == pytest.approx((4 - 1) * (2 - 1))
    assert not plan.parts(30.0)


@pytest.mark.parametrize(
    ("plan", "given", "words"),
    [
        (FloorPlan(), (1.0,), r"width and height are needed, as in parts\(1.0, room=\(25, 25\)\)"),
        (FloorPlan(), (1.0, (3,)), r"in a room of \(3,\): width and height"),
        (FloorPlan(), (0.0, (20, 20)), "a diameter from a 500th of the floor's longer side on is needed"),
        (FloorPlan(), (0.03, (20, 20)), "a disc of 0.03 m on a floor of 20 x 20 m"),
        (FloorPlan(), (1.0, (-20, 20)), "on a floor of -20 x 20 m"),
        (FloorPlan(), (math.nan, (20, 20)), "parts has nan: a number"),
    ],
)
def test_discs_and_rooms_that_cannot_be_are_refused(plan: FloorPlan, given: Any, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        plan.parts(*given)


def test_the_command_warns_of_parts(capsys: Any, tmp_path: Path) -> None:
    """In one line; not of a floor that is one, nor of what a generator draws."""
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
            assert (
                sum("compil" not in line for line in err.splitlines()) == 1
            )  # that is said where it is the first time


def test_many_parts_are_not_all_listed(capsys: Any, tmp_path: Path) -> None:
    (tmp_path / "cells.txt").write_text(("...#" * 8 + "\n") * 3)
    given = ("--set", "safe_zone_radii=1,0.5", "--set", "agents_radius=0.3", "--set", "n_boxes=1", "--set", "n_heals=2")
    assert "; 4 more\n" in run(capsys, "layout", tmp_path / "cells.txt", *given, "--out", tmp_path / "a.png")[2]
