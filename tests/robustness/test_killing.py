"""Whoever is killed, stopped or short of disk leaves files that open, and commands that go on: see killing."""

import signal
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import COMPILED
from tests.killing import NOTHING, Trial, Writer, drafts, main, run, shares, tried, writers
from tests.killing_process import Moment

pytestmark = pytest.mark.skipif(not COMPILED, reason="the same files, written slower")
for library in ("torch", "stable_baselines3", "tensorboard", "matplotlib", "pyarrow", "minari", "imageio_ffmpeg"):
    pytest.importorskip(library, reason=f"needs {library}: outlast[test]")

KNOWN = {writer.name: writer for writer in writers()}
DISK = {  # bytes that a file may have: too few for the largest that is written
    "rollout --record": 100_000,
    "frames .webm": 5_000,
    "frames .mp4": 5_000,
    "frames .apng": 5_000,
    "frames .gif": 5_000,
    "frames folder": 500,
    "frames over frames": 500,
    "replay samples.parquet": 20_000,
    "replay shards": 20_000,
    "replay page": 20_000,
    "replay minari": 5_000,
    "train": 6_000,
    "plot": 2_000,
    "evaluate": 1_000,
    "evaluate --film": 3_000,
}


@pytest.mark.parametrize(("name", "times"), [pytest.param("train", 1, marks=pytest.mark.nightly), ("replay shards", 1)])
def test_who_is_killed_leaves_what_opens_and_goes_on(tmp_path: Path, name: str, times: int) -> None:
    assert tried(KNOWN[name], times, tmp_path).failures == []


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name, writer in KNOWN.items() if not writer.costly])
def test_who_is_killed_at_other_moments(tmp_path: Path, name: str) -> None:
    """Fifty kills together."""
    tally = tried(KNOWN[name], 4 if name == "train" else 3, tmp_path, seed=1)
    assert tally.failures == []
    assert tally.late < tally.kills


@pytest.mark.nightly
def test_a_cache_that_was_being_filled_is_filled_again(tmp_path: Path) -> None:
    assert tried(KNOWN["compiled tick"], 2, tmp_path).failures == []


CARELESS = """
import sys, time
with open(sys.argv[1], "w", 1) as file:
    for line in range(20): file.write("a line\\n"); time.sleep(0.05)
"""


class Careless(Writer):
    """What writes in place, bit by bit."""

    name = "careless"

    def words(self, place: Path, again: bool = False) -> list[str]:
        code = CARELESS.strip().replace("sys.argv[1]", repr(str(place / "a.txt")))
        return ["timeit", "-n", "1", "-r", "1", "-s", "", code]

    def check(self, place: Path, whole: Path) -> str:
        if not (place / "a.txt").exists():
            return NOTHING
        assert (place / "a.txt").read_text() == (whole / "a.txt").read_text()
        return "whole"

    def same(self, place: Path, whole: Path) -> None:
        self.check(place, whole)


def test_what_is_written_carelessly_is_found_out(tmp_path: Path) -> None:
    tally = tried(Careless(), 6, tmp_path)
    assert tally.kills == 6
    assert any("killed at" in failure for failure in tally.failures)


def test_kills_are_shared_out() -> None:
    found = shares(KNOWN.values(), 200)
    assert 190 <= sum(found.values()) <= 210
    assert min(found.values()) >= 1
    assert found[KNOWN["compiled tick"]] < found[KNOWN["train"]]


@pytest.mark.nightly
def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay-page", "--times", "1"]) == 0
    assert "replay page                1 " in capsys.readouterr().out


# ---- a full disk


@pytest.mark.nightly
@pytest.mark.parametrize("name", DISK)
def test_a_full_disk_is_told_in_one_line_and_leaves_nothing_corrupt(tmp_path: Path, name: str) -> None:
    """No file may grow beyond so many bytes; with more of them, the same command goes on."""
    trial = Trial(KNOWN[name], tmp_path, np.random.default_rng(0))
    place = trial._place("full")
    ended = run(trial.writer, place, limit=DISK[name])
    assert ended.status == 2, ended.err
    assert len(ended.err.strip().splitlines()) == 1, ended.err
    assert ended.err.startswith("outlast: ")
    assert any(words in ended.err for words in ("File too large", "File size limit exceeded", "is the disk full"))
    assert drafts(place) == []
    trial.writer.check(place, trial.whole)
    assert run(trial.writer, place, again=True).status == 0
    trial.writer.same(place, trial.whole)


# ---- Ctrl-C


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        pytest.param("train", Moment(imported="torch", sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("train", Moment(operation=1, sent=signal.SIGINT), marks=pytest.mark.nightly),
        ("train", Moment(seconds=1.0, sent=signal.SIGINT)),
        ("plot", Moment(imported="matplotlib", sent=signal.SIGINT)),
        pytest.param("plot", Moment(operation=9, sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("evaluate", Moment(imported="torch", sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("evaluate", Moment(operation=2, sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("evaluate --film", Moment(imported="cv2", sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("rollout --record", Moment(operation=1, sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("replay page", Moment(operation=1, sent=signal.SIGINT), marks=pytest.mark.nightly),
        ("frames folder", Moment(operation=1, sent=signal.SIGINT)),
    ],
    ids=str,
)
def test_ctrl_c_is_one_line_and_status_130(tmp_path: Path, name: str, moment: Moment) -> None:
    """At its first operations on files, while libraries load, and at work; without what was half there."""
    writer = KNOWN[name]
    writer.prepare(tmp_path)
    ended = run(writer, tmp_path, moment)
    assert ended.status == 130, ended.err
    assert len(ended.err.strip().splitlines()) == 1, ended.err
    assert "stopped" in ended.err
    assert drafts(tmp_path) == []
