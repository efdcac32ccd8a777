"""The command `outlast layout`, and the option --layout of commands that name a game."""

from pathlib import Path
from typing import Any

import cv2
import pytest

from outlast import FloorPlan
from tests.conftest import run


def test_layouts_are_drawn_and_written_down(capsys: Any, tmp_path: Path) -> None:
    """A picture of several worlds; and a plan, of which the next call draws the same picture."""
    assert run(capsys, "layout", "pillars", "--set", "n_pillars=5", "--out", tmp_path / "plan.json")[0] == 0
    assert len(FloorPlan.load(tmp_path / "plan.json").walls) == 5
    for name, out in (("pillars", "one.png"), (tmp_path / "plan.json", "two.png")):
        more = ("--set", "n_pillars=5") if name == "pillars" else ()
        assert run(capsys, "layout", name, *more, "--variant", "ffa_1", "--out", tmp_path / out)[0] == 0
    one, two = (cv2.imread(str(tmp_path / out)) for out in ("one.png", "two.png"))
    assert (one.shape, two.shape) == ((384, 384, 3), (384, 384, 3))
    assert (one != two).any(-1).mean() < 0.02  # who starts where is drawn by another mechanic
    assert run(capsys, "layout", "pillars", "--worlds", 3, "--out", tmp_path / "three.png")[0] == 0
    assert cv2.imread(str(tmp_path / "three.png")).shape == (776, 776, 3)


def test_a_floor_plan_overwrites_nothing(capsys: Any, tmp_path: Path, monkeypatch: Any) -> None:
    """Start areas are not written: the plan says so."""
    monkeypatch.chdir(tmp_path)
    FloorPlan(walls=[(0, 0, 6, 0.4)], starts=[(0, -8, 0, 4, 8), (1, 8, 0, 4, 8)]).save("plan.json")
    before = Path("plan.json").read_bytes()
    status, _, err = run(capsys, "layout", "./plan.json", "--out", "plan.json")
    assert (status, err) == (2, "outlast: LAYOUT and --out are both plan.json: give another name for one\n")
    status, _, err = run(capsys, "layout", "plan.json", "--variant", "ffa_1", "--out", "walls.json")
    assert (status, "plan.json has start areas, which are not written" in err) == (0, True)
    status, _, err = run(capsys, "layout", "maze", "--out", "plan.json")
    assert (status, "plan.json exists; floor plans overwrite nothing" in err) == (2, True)
    assert Path("plan.json").read_bytes() == before


def test_layouts_are_shown_on_a_page(capsys: Any, tmp_path: Path) -> None:
    assert run(capsys, "layout", "rooms", "--worlds", 2, "--out", tmp_path / "rooms.html")[0] == 0
    assert "<title>rooms: ffa_3-with_rooms" in (tmp_path / "rooms.html").read_text()


def test_commands_take_a_layout(capsys: Any, tmp_path: Path) -> None:
    (tmp_path / "plan.txt").write_text("A" + "." * 38 + "B\n" + "." * 40 + "\n" + ".....#" * 6 + "....\n" + "." * 40)
    given = ("rollout", "ffa_1", "--layout", tmp_path / "plan.txt", "--set", "safe_zone_radii=2,1")
    assert "room_width=40" in run(capsys, *given, "--worlds", 2, "--steps", 5, "--quiet")[1]
    assert run(capsys, "schedule", "ffa_1", "--layout", "maze")[1].count("maze.") > 3


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("layout", "nowhere", "--out", "x.png"), "layout nowhere: No such file or directory; maze, rooms, pillars"),
        (("layout", "maze", "--out", "x.gif"), "x.gif: layouts are written as NAME.png or NAME.html or NAME.json"),
        (("layout", "maze", "--size", "9999", "--out", "x.png"), "--size 9999: pixels from 64 to 4096"),
        (("layout", "maze", "--size", "200", "--out", "x.html"), "--size 200 is for pictures"),
        (("layout", "maze", "--worlds", "2", "--out", "x.json"), "is for the floor plan of one world"),
        (("layout", "maze", "--out", "/nowhere/x.json"), "/nowhere/x.json cannot be written: there is no folder"),
        (
            ("layout", "maze", "--worlds", "100000", "--out", "x.png"),
            "are 124264 pixels wide; at most 16384 are possible",
        ),
        (("layout", "x.json", "--out", "x.json"), "LAYOUT and --out are both x.json: give another name for one"),
        (("rollout", "ffa_1", "--layout", "/dev/null"), "/dev/null is no floor plan: a drawing of 0 x 0 characters"),
    ],
)
def test_what_cannot_be_is_one_line(capsys: Any, given: tuple[str, ...], words: str) -> None:
    status, _, err = run(capsys, *given)
    assert status == 2
    assert words in err
