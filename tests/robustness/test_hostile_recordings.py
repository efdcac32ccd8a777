"""Hostile recordings with correct checksums: worlds that would need all memory or time, and invalid headers."""

from pathlib import Path

import pytest

from outlast import systems
from outlast.envs.cli.main import main
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, Replay
from tests.fuzz.mutations import memory_limit
from tests.fuzz.worlds import Recordings


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return Recordings()


ABSURD = {
    "slots": ({"inventory_slots": 2**31 - 1}, r"inventory.slots = 2147483647: must be >= 1 and <= 65536"),
    "cells": ({"spawn_grid_cells": 2**30}, "spawn_grid.cells = 1073741824: must be"),
    "agents": ({"agents_count": 2**31 - 1}, "agents.count = 2147483647: must be"),
    "heals": ({"heals_count": 900_000, "spawn_grid_cells": 250}, "heals.count = 900000: must be"),
    "bags": ({"inventory_slots": 60_000}, "a world would have 5.* bytes of state: at most 4194304 is possible"),
    "bodies": ({"agents_count": 600, "spawn_grid_cells": 100}, "604 bodies that take part in contacts"),
    "others": ({"agents_count": 3}, "agents are 2 there and 3 here"),
    "substeps": ({"physics_substeps": 2**31 - 1}, "physics.substeps = 2147483647: must be >= 1 and <= 100"),
    "iterations": ({"physics_velocity_iterations": 10**9}, "physics.velocity_iterations = .* <= 1000"),
}


@pytest.mark.parametrize("what", ABSURD)
def test_recordings_of_absurd_worlds_are_refused_before_anything_is_made(
    tmp_path: Path, recordings: Recordings, what: str
) -> None:
    changes, reason = ABSURD[what]
    (tmp_path / "a.rec").write_bytes(recordings.changed(recordings.valid, **changes))
    with memory_limit(2**23), pytest.raises(RecordingError, match=reason):
        Recording.open(tmp_path / "a.rec")
    (tmp_path / "a.rec").write_bytes(recordings.changed(recordings.valid))
    assert len(Recording.open(tmp_path / "a.rec"))


def test_many_worlds_in_few_bytes_are_refused(tmp_path: Path, recordings: Recordings) -> None:
    large = recordings.changed(recordings.valid, {"worlds": 1000}, inventory_slots=40_000)
    (tmp_path / "a.rec").write_bytes(large)
    with pytest.raises(RecordingError, match=r"its worlds would take 33\d{8} bytes: 1\d{9} are given to"):
        Recording.open(tmp_path / "a.rec")
    many = recordings.changed(recordings.valid, {"worlds": 10_000})  # not too large, but more than there are
    (tmp_path / "a.rec").write_bytes(many)
    with pytest.raises(RecordingError, match="is damaged"):
        Recording.open(tmp_path / "a.rec")


@pytest.mark.parametrize(
    "head",
    [
        {"outlast": "\x1b[31m"},
        {"machine": "\ud800"},
        {"machine": "x" * 300},
        {"scenario": {"name": "a\nb", "numbers": {}}},
        {"scenario": {"name": "ffa_1", "numbers": {"x": {}}}},
        {"scenario": {"name": "ffa_1", "numbers": {"x": None}}},
        {"modules": "outlast.systems.melee.Melee"},
        {"first_world": -1},
        {"first_world": 2**64},
        {"digests": {"components": "abc", "worlds": 1, "repeat": 1}},
        {"digests": {"components": [], "worlds": 0, "repeat": 1}},
    ],
)
def test_headers_that_could_not_be_shown_or_computed_with_are_refused(
    tmp_path: Path, recordings: Recordings, head: dict[str, object]
) -> None:
    (tmp_path / "a.rec").write_bytes(recordings.changed(recordings.valid, head))
    with pytest.raises(RecordingError, match=r"its header does not describe a recording|the number .* is missing"):
        Recording.open(tmp_path / "a.rec")


@pytest.mark.parametrize("left", [("Ending",), ("Agents",), ("Rewards", "Ending", "Record"), ("FreeForAll", "Room")])
def test_worlds_that_cannot_be_played_are_refused(
    tmp_path: Path, recordings: Recordings, left: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Mechanics of outlast without others that they need."""
    path = tmp_path / "a.rec"
    path.write_bytes(recordings.valid)
    head = Recording.open(path).header
    modules = [name for name in head["modules"] if name.rsplit(".", 1)[1] not in left]
    gone = tuple(f"{systems.__dict__[name].name}_" for name in left)
    numbers = {key: value for key, value in head["scenario"]["numbers"].items() if not key.startswith(gone)}
    path.write_bytes(
        recordings.changed(recordings.valid, {"modules": modules, "scenario": {"name": "x", "numbers": numbers}})
    )
    with pytest.raises(RecordingError, match="its worlds cannot be made"):
        Replay(Recording.open(path))
    assert main(["replay", str(path)]) == 2
    assert capsys.readouterr().err.startswith("outlast: ")
