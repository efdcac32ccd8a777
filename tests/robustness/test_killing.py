"""Commands that are killed, interrupted or out of disk space leave files that open, and can be run again."""

import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.killing.harness import Moment, Trial, Writer, run, same_bytes, temporary_files
from tests.killing.writers import WRITERS

KNOWN = {writer.name: writer for writer in WRITERS}
EXTRAS = {  # by library
    **dict.fromkeys(("torch", "tensorboard"), "train"),
    **dict.fromkeys(("pyarrow", "minari"), "data"),
    "matplotlib": "plot",
    "imageio_ffmpeg": "view",
}
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


def mostly_nightly(cases: Iterable[tuple[Any, ...]], by_day: tuple[str, ...]) -> list[Any]:
    """Cases of which those of the named writers run by day."""
    return [case if case[0] in by_day else pytest.param(*case, marks=pytest.mark.nightly) for case in cases]


def writer_of(name: str) -> Writer:
    """The writer of that name; the test is skipped without the libraries that it needs."""
    for library in KNOWN[name].needs:
        pytest.importorskip(library, reason=f"needs {library}: outlast[{EXTRAS[library]}]")
    return KNOWN[name]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(("name", "times"), [*mostly_nightly([(name, 3) for name in KNOWN], ()), ("replay shards", 1)])
def test_a_killed_process_leaves_files_that_open_and_go_on(tmp_path: Path, name: str, times: int) -> None:
    statuses = Trial(writer_of(name), tmp_path).kill(times)
    assert times == 1 or any(statuses)


CARELESS = """timeit -n 1 -r 1 -s "import time; file = open('{out}', 'w', 1)"
"for line in range(20): file.write('a line\\n'); time.sleep(0.05)"
"""


@pytest.mark.nightly
def test_what_is_written_carelessly_is_found_out(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="careless, killed at"):
        Trial(Writer("careless", CARELESS, "a.txt", same_bytes), tmp_path).kill(6)


@pytest.mark.parametrize(("name", "limit"), mostly_nightly(DISK.items(), ("rollout --record",)))
def test_a_full_disk_is_reported_in_one_line_and_leaves_nothing_corrupt(tmp_path: Path, name: str, limit: int) -> None:
    trial = Trial(writer_of(name), tmp_path)
    folder = trial.new_folder("full")
    outcome = run(trial.writer, folder, limit=limit)
    assert outcome.status == 2, outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err
    assert outcome.err.startswith("outlast: ")
    assert any(words in outcome.err for words in ("File too large", "File size limit exceeded", "is the disk full"))
    assert temporary_files(folder) == []
    trial.check(folder)


MOMENTS = [
    ("train", Moment(imported="torch", sent=signal.SIGINT)),
    ("train", Moment(operation=1, sent=signal.SIGINT)),
    ("train", Moment(seconds=0.4, sent=signal.SIGINT)),
    ("plot", Moment(imported="matplotlib", sent=signal.SIGINT)),
    ("evaluate", Moment(imported="torch", sent=signal.SIGINT)),
    ("evaluate", Moment(operation=2, sent=signal.SIGINT)),
    ("evaluate --film", Moment(imported="cv2", sent=signal.SIGINT)),
    ("rollout --record", Moment(operation=1, sent=signal.SIGINT)),
    ("replay page", Moment(operation=1, sent=signal.SIGINT)),
    ("frames folder", Moment(operation=1, sent=signal.SIGINT)),
    *((f"frames {suffix}", Moment(seconds=0.1, sent=signal.SIGINT)) for suffix in (".webm", ".mp4", ".apng", ".gif")),
]


@pytest.mark.parametrize(("name", "moment"), mostly_nightly(MOMENTS, ("frames folder",)), ids=str)
def test_ctrl_c_is_one_line_and_status_130(tmp_path: Path, name: str, moment: Moment) -> None:
    writer = writer_of(name)
    writer.prepare(tmp_path)
    outcome = run(writer, tmp_path, moment)
    assert outcome.status == 130, outcome.err
    assert len(outcome.err.strip().splitlines()) == 1, outcome.err
    assert "stopped" in outcome.err
    assert temporary_files(tmp_path) == []
