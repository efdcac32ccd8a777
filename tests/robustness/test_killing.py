"""Commands that are killed, interrupted or out of disk space leave files that open, and can be run again."""

import signal
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import COMPILED
from tests.killing.__main__ import Trial, kill_repeatedly, kills_per_writer, main, run, writers
from tests.killing.process import Moment
from tests.killing.writer import COMPLETE, NOTHING, Writer, temporary_files

pytestmark = pytest.mark.skipif(not COMPILED, reason="the same files, written slower")
for library in ("torch", "tensorboard", "matplotlib", "pyarrow", "minari", "imageio_ffmpeg"):
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
def test_a_killed_process_leaves_files_that_open_and_go_on(tmp_path: Path, name: str, times: int) -> None:
    assert kill_repeatedly(KNOWN[name], times, tmp_path).failures == []


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name, writer in KNOWN.items() if not writer.slow])
def test_processes_killed_at_other_moments(tmp_path: Path, name: str) -> None:
    """Fifty kills together."""
    tally = kill_repeatedly(KNOWN[name], 4 if name == "train" else 3, tmp_path, seed=1)
    assert tally.failures == []
    assert tally.late < tally.kills


@pytest.mark.nightly
def test_a_cache_that_was_being_filled_is_filled_again(tmp_path: Path) -> None:
    assert kill_repeatedly(KNOWN["compiled tick"], 2, tmp_path).failures == []


CARELESS = """
import sys, time
with open(sys.argv[1], "w", 1) as file:
    for line in range(20): file.write("a line\\n"); time.sleep(0.05)
"""


class Careless(Writer):
    """A writer that writes in place, line by line."""

    name = "careless"

    def command(self, folder: Path, resume: bool = False) -> list[str]:
        code = CARELESS.strip().replace("sys.argv[1]", repr(str(folder / "a.txt")))
        return ["timeit", "-n", "1", "-r", "1", "-s", "", code]

    def check(self, folder: Path, reference: Path) -> str:
        if not (folder / "a.txt").exists():
            return NOTHING
        assert (folder / "a.txt").read_text() == (reference / "a.txt").read_text()
        return COMPLETE

    def check_resumed(self, folder: Path, reference: Path) -> None:
        self.check(folder, reference)


@pytest.mark.nightly
def test_what_is_written_carelessly_is_found_out(tmp_path: Path) -> None:
    tally = kill_repeatedly(Careless(), 6, tmp_path)
    assert tally.kills == 6
    assert any("killed at" in failure for failure in tally.failures)


def test_kills_are_shared_out() -> None:
    found = kills_per_writer(KNOWN.values(), 200)
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
def test_a_full_disk_is_reported_in_one_line_and_leaves_nothing_corrupt(tmp_path: Path, name: str) -> None:
    """Files are limited to that many bytes; without the limit, the same command goes on."""
    trial = Trial(KNOWN[name], tmp_path, np.random.default_rng(0))
    folder = trial._new_folder("full")
    outcome = run(trial.writer, folder, limit=DISK[name])
    assert outcome.status == 2, outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err
    assert outcome.err.startswith("outlast: ")
    assert any(command in outcome.err for command in ("File too large", "File size limit exceeded", "is the disk full"))
    assert temporary_files(folder) == []
    trial.writer.check(folder, trial.reference)
    assert run(trial.writer, folder, resume=True).status == 0
    trial.writer.check_resumed(folder, trial.reference)


# ---- Ctrl-C


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        pytest.param("train", Moment(imported="torch", sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("train", Moment(operation=1, sent=signal.SIGINT), marks=pytest.mark.nightly),
        pytest.param("train", Moment(seconds=0.4, sent=signal.SIGINT), marks=pytest.mark.nightly),
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
    """While libraries load, at its first file operations and at work; no temporary file is left."""
    writer = KNOWN[name]
    writer.prepare(tmp_path)
    outcome = run(writer, tmp_path, moment)
    assert outcome.status == 130, outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err
    assert "stopped" in outcome.err
    assert temporary_files(tmp_path) == []
