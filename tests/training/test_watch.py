"""Watching a run: what is played, what is shown, and the command."""

import base64
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.conftest import call
from tests.web.clients import answer

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.envs.errors import PlayError  # noqa: E402
from outlast.envs.rollout.saved import CHECKPOINT  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.log_file import HEADER, read_log  # noqa: E402
from outlast.training.cli import watch as command  # noqa: E402
from outlast.training.runs import watch  # noqa: E402
from outlast.training.runs.logs import CsvLog  # noqa: E402
from outlast.training.runs.watch import RunWatcher, figures  # noqa: E402
from tests.helpers.checkpoints import as_checkpoint  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_checkpoint("teams_3/original-0", tmp_path_factory.mktemp("kept") / "a.zip")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "teams_3-original-0"
    made.mkdir()
    return made


@pytest.fixture
def watched(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RunWatcher]:
    monkeypatch.setattr(watch, "POLL", 0.02)
    monkeypatch.setattr(watch, "MOST", 40)
    watcher, stop = RunWatcher(folder), threading.Event()
    thread = threading.Thread(target=watcher.record, args=(stop,))
    thread.start()
    yield watcher
    stop.set()
    thread.join(20)
    assert not thread.is_alive()


def add(folder: Path, steps: int, policy: Path) -> Path:
    """A checkpoint, as training writes it: at once."""
    shutil.copy(policy, folder / "new")
    return (folder / "new").replace(folder / CHECKPOINT.format(steps))


def whole(watcher: RunWatcher) -> bool:
    """Whether the newest episode is there to its end."""
    return bool(watcher.recorded and watcher.recorded["whole"])


def until(watcher: RunWatcher, condition: Callable[[Any], bool]) -> Any:
    """The first status for which the condition holds."""
    deadline = time.monotonic() + 60
    while not condition(status := watcher.status()):
        assert time.monotonic() < deadline, status
        time.sleep(0.02)
    return status


def log(folder: Path, *rows: tuple[str, int, float]) -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join([",".join(HEADER), *(f"{tag},{step},{value}" for tag, step, value in rows), ""]))
    return path


# ---- what is played


def test_it_waits_for_the_first_checkpoint_and_plays_it(watched: RunWatcher, folder: Path, policy: Path) -> None:
    status = watched.status()
    assert status["message"] == f"There is no checkpoint in {folder} yet: the first one will be played."
    assert (status["newest"], status["episode"], watched.episode(), status["figures"]) == (None, None, None, [])
    add(folder, 1024, policy)
    status = until(watched, lambda status: bool(status["episode"]))
    assert (status["message"], status["newest"]["steps"]) == ("", 1024)
    assert 0 <= status["newest"]["age"] < 60
    until(watched, lambda status: whole(watched))
    found = watched.episode()
    assert found is not None
    assert (found["steps"], found["game"], found["ticks"]) == (1024, "teams_3", 41)
    assert base64.b64decode(found["data"])[:2] == b"\x1f\x8b"


def test_the_first_episode_grows_and_later_ones_are_whole(
    watched: RunWatcher, folder: Path, policy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page has a picture after the first tick, and need not wait for a whole episode."""
    published, published_as = list[tuple[int, int, bool]](), watch._published

    def note(known: Any, *recorded: Any, **more: Any) -> Any:
        made = published_as(known, *recorded, **more)
        published.append((made["number"], made["ticks"], made["whole"]))
        return made

    monkeypatch.setattr(watch, "_published", note)
    add(folder, 1024, policy)
    until(watched, lambda status: whole(watched))
    watched.episode()
    until(watched, lambda status: status["episode"]["number"] == 2)
    beginnings = [(1, ticks, False) for ticks in (1, 2, 4, 8, 16, 32)]
    assert published[:8] == [*beginnings, (1, 41, True), (2, 41, True)]


def test_a_first_episode_that_breaks_off_is_replaced_by_one_of_an_older_checkpoint(
    watched: RunWatcher, folder: Path, policy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = list[None]()

    def broken(stop: threading.Event, ticks: Iterator[int]) -> Iterator[int]:
        begun.append(None)
        for tick in ticks:
            if len(begun) == 1 and tick == 3:
                raise RuntimeError("a fault in this world")
            yield tick

    monkeypatch.setattr(watch, "_until", broken)
    for steps in (1024, 2048):
        add(folder, steps, policy)
    status = until(watched, lambda status: whole(watched))
    assert status["message"] == f"{CHECKPOINT.format(2048)} cannot be played: a fault in this world."
    assert status["episode"] == {"number": 2, "steps": 1024}


def test_another_episode_is_played_when_one_was_taken(watched: RunWatcher, folder: Path, policy: Path) -> None:
    add(folder, 1024, policy)
    until(watched, lambda status: whole(watched))
    first = watched.status()["episode"]["number"]
    time.sleep(0.3)
    assert watched.status()["episode"]["number"] == first  # nobody took it
    one, again = watched.episode(), watched.episode()
    assert one is not None
    assert again is not None
    assert one["number"] == first
    until(watched, lambda status: status["episode"]["number"] > first)
    other = watched.episode()
    assert other is not None
    assert other["data"] != one["data"]


def test_a_newer_checkpoint_takes_its_place(watched: RunWatcher, folder: Path, policy: Path) -> None:
    add(folder, 1024, policy)
    first = until(watched, lambda status: bool(status["episode"]))["episode"]["number"]
    add(folder, 2048, policy)
    status = until(watched, lambda status: status["episode"]["number"] > first)
    assert status["newest"]["steps"] == status["episode"]["steps"] == 2048
    assert watched.source is not None
    assert watched.source[0].name == CHECKPOINT.format(2048)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"x" * 1000], ids=["empty", "cut", "noise"])
def test_a_broken_checkpoint_is_reported_and_an_older_one_played(
    watched: RunWatcher, folder: Path, policy: Path, content: bytes
) -> None:
    add(folder, 1024, policy)
    broken = folder / CHECKPOINT.format(2048)
    broken.write_bytes(content)
    status = until(watched, lambda status: bool(status["episode"]))
    assert re.match(f"{broken.name} cannot be played: .+", status["message"])
    time.sleep(0.1)
    assert len(watched.broken) == 1  # it is not tried again
    add(folder, 2048, policy)
    os.utime(broken, (1, 1))
    until(watched, lambda status: watched.source == (broken, 10**9))
    assert watched.status()["message"] == ""


def test_where_no_checkpoint_can_be_played_none_is_said_to_be(watched: RunWatcher, folder: Path) -> None:
    (folder / CHECKPOINT.format(1024)).write_bytes(b"")
    until(watched, lambda status: "cannot be played" in status["message"])
    assert watched.status()["message"].startswith(CHECKPOINT.format(1024))


def test_checkpoints_and_folders_may_vanish(watched: RunWatcher, folder: Path, policy: Path) -> None:
    add(folder, 1024, policy)
    until(watched, lambda status: bool(status["episode"]))
    shutil.rmtree(folder)
    assert watched.status()["message"] == f"There is no folder {folder} any more."
    assert watched.episode() is not None


def test_nothing_is_played_while_nobody_looks(folder: Path, policy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add(folder, 1024, policy)
    watcher = RunWatcher(folder)
    monkeypatch.setattr(watch, "AWAY", -1.0)
    watcher.status()
    assert watcher._wanted() is None
    monkeypatch.setattr(watch, "AWAY", 60.0)
    assert watcher._wanted() is not None


# ---- what is shown


def test_figures_come_from_the_log(folder: Path) -> None:
    rows = [("rollout/steps", 10 * k, 100.0 + k) for k in range(1, 1001)]
    rows += [(f"rollout/kills{side}", 10 * k, k / 1000) for k in range(1, 1001) for side in (0, 1)]
    rows += [("wins/past", 10_000, 0.5), ("time/collected_per_second", 10_000, 5e4), ("behaviour/near", 10, 1.0)]
    found = {figure["name"]: figure for figure in figures(read_log(log(folder, *rows)))}
    assert list(found) == ["collecting", "length", "kills", "past"]
    assert (found["length"]["text"], found["length"]["group"]) == ("1,100", "episodes")
    points = found["length"]["points"]
    assert points[0] == (90, 105.0)  # of nine neighbours
    assert points[-1] == (10_000, 1100.0)
    assert len(points) <= watch.POINTS
    assert [step for step, _ in points] == sorted({step for step, _ in points})
    assert all(value == pytest.approx(2 * (step - 40) / 10_000) for step, value in found["kills"]["points"][:-1])
    assert found["past"]["points"] == [(10_000, 0.5)]
    assert found["collecting"]["points"] is None
    assert figures({}) == []


def test_curves_are_thinned_together(folder: Path) -> None:
    """Sums over sides are of the same steps, although a rollout lacks a side."""
    rows = [(f"rollout/kills{side}", k, 1.0) for k in range(1, 301) for side in (0, 1, 2) if (side, k) != (2, 150)]
    (kills,) = [each for each in figures(read_log(log(folder, *rows))) if each["name"] == "kills"]
    assert [(step, value) for step, value in kills["points"] if value != 3] == [(150, pytest.approx(8 / 3))]
    assert len(kills["points"]) <= watch.POINTS


def test_nothing_is_lost_where_episodes_end_in_some_rollouts_only(folder: Path) -> None:
    rows = [("train/entropy", k, 5.0) for k in range(1, 601)] + [
        ("rollout/steps", k, 1.0 * k) for k in range(6, 601, 6)
    ]
    (length,) = [each for each in figures(read_log(log(folder, *rows))) if each["name"] == "length"]
    assert length["points"] == [(k, k) for k in range(6, 601, 6)]


def test_a_log_without_a_row_is_waited_for(folder: Path) -> None:
    path, watcher = folder / "log.csv", RunWatcher(folder)
    for text in ("", "tag,step,value\n"):
        path.write_text(text)
        assert watcher.status()["figures"] == []
        assert "is not the log" not in watcher.status()["message"]
    path.unlink()
    begun = CsvLog(path)
    assert path.read_text() == "tag,step,value\n"  # while the run collects its first rollout
    begun.close()


def test_a_log_is_read_again_when_it_has_changed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watcher, reads = RunWatcher(folder), list[Path]()
    monkeypatch.setattr(watch.log_file, "read_log", lambda path: reads.append(path) or read_log(path))
    log(folder, ("rollout/steps", 10, 100.0))
    texts = [watcher.status()["figures"][0]["text"] for _ in range(3)]
    path = log(folder, ("rollout/steps", 10, 100.0), ("rollout/steps", 20, 200.0))
    assert [*texts, watcher.status()["figures"][0]["text"]] == ["100", "100", "100", "200"]
    assert len(reads) == 2
    path.write_text(path.read_text() + "rollout/ste")  # half a row, which the run is writing
    assert watcher.status()["figures"][0]["text"] == "200"
    path.write_text("nonsense")
    status = watcher.status()
    assert "is not the log of a run" in status["message"]
    assert status["figures"][0]["text"] == "200"


def test_a_status_is_json_whatever_was_logged(folder: Path) -> None:
    log(folder, ("rollout/steps", 10, float("nan")), ("wins/past", 10, float("inf")), ("rollout/heals_used", 10, 1.0))
    status = RunWatcher(folder).status()
    assert [figure["name"] for figure in status["figures"]] == ["heals used"]
    json.dumps(status, allow_nan=False)


# ---- the command

COMMAND = (  # for a process, also where the entry point has not been installed
    "import sys; from outlast.envs.cli.grammar import Parser; from outlast.training.cli import watch; "
    "parser = Parser(); watch.add(parser.add_subparsers()); "
    "options = parser.parse_args(['watch', sys.argv[1], '--no-browser']); "
    "sys.exit(options.run(options))"
)
outlast_watch = partial(call, command, "--no-browser")


def test_the_command_is_there_without_torch() -> None:
    text = "import sys, outlast.training.cli.watch; assert not {'torch', 'http.server'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", text], check=True)


def test_without_torch_the_cure_is_reported(folder: Path) -> None:
    code = f"import sys; sys.modules['torch'] = None; {COMMAND}"
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False)
    assert "watching needs torch: pip install 'outlast[train]'" in done.stderr


def test_folders_that_are_no_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"there is no folder .*nowhere"):
        outlast_watch(tmp_path / "nowhere")
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").touch()
    with pytest.raises(TrainingError, match=rf"holds several runs; choose one: {tmp_path}/a, {tmp_path}/b$"):
        outlast_watch(tmp_path)


def test_a_taken_port_is_reported(folder: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PlayError, match=rf"port {port} of 127.0.0.1 is not to be had: .*; leave --port out"):
            outlast_watch(folder, "--port", port)
    assert not any(thread.name.endswith("(record)") for thread in threading.enumerate())


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
def test_ctrl_c_ends_it_cleanly(folder: Path, policy: Path) -> None:
    add(folder, 1024, policy)
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith(f"{folder}: its newest policy plays at http://127.0.0.1:")
        address = line.split()[-1]
        status, _, body = answer(address, urlsplit(address).path + "status.json")
        assert (status, json.loads(body)["newest"]["steps"]) == (200, 1024)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, err.strip()) == (0, "")
