"""What is shown of a run: in the terminal, in logs and films, and on the page that plays its newest policy."""

import base64
import importlib
import io
import logging
import math
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from outlast import variant
from outlast.components import Body
from outlast.envs import progress
from outlast.envs.api.film import HOLD
from outlast.envs.cli.options import messages_shown
from outlast.envs.progress import Progress
from outlast.envs.rendering import films
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.fingerprint import classes, difference, fingerprint
from outlast.training.base import policy_file
from outlast.training.base.curves import HEADING, read_log
from outlast.training.base.errors import TrainingError
from outlast.training.base.quantities import GROUPS, Figure, LiveView, headline
from outlast.training.cli import watch as command
from outlast.training.runs import film, watch
from outlast.training.runs.film import episode, film_checkpoint, recorded_scenario
from outlast.training.runs.run import RunLog
from outlast.training.runs.watch import RunWatcher, figures
from tests.conftest import call
from tests.helpers.checkpoints import KEPT, as_checkpoint

TAGS = {"time/collected_per_second": 90_123.0, "time/updated_per_second": 36_500.0, "time/fps": 24_000.0}
TAGS |= {"rollout/steps": 812.4, "rollout/reward0": 400.0, "rollout/reward1": 420.0, "rollout/heals_used": 2.7}
TAGS |= {"rollout/kills0": 0.25, "rollout/kills1": 0.5, "train/epochs": 3.25, "train/approx_kl": 0.0113}
TAGS |= {"behaviour/near": 0.1, "train/entropy": 4.211}
TAGS |= {"wins/scripted": 0.118, "games/scripted": 310, "wins/past": 0.55}


class Terminal(io.StringIO):
    """As much of a terminal as progress bars need."""

    def isatty(self) -> bool:
        return True

    def rows(self) -> list[str]:
        """What is on it, down to the last row that is not empty; and the row that the cursor is in."""
        rows, row, column = [""], 0, 0
        for code, text in re.findall(r"(\x1b\[\d*[AKJ]|[\r\n])|([^\x1b\r\n]+)", self.getvalue()):
            if text:
                rows[row] = rows[row][:column].ljust(column) + text + rows[row][column + len(text) :]
                column += len(text)
            elif code == "\r":
                column = 0
            elif code == "\n":
                row, column = row + 1, 0
                rows += [""] * (row == len(rows))
            elif code.endswith("A"):
                row -= int(code[2:-1] or 1)
                assert row >= 0, "above the terminal"
            else:
                rows[row] = rows[row][:column]
                rows = rows[: row + 1] if code.endswith("J") else rows
        self.row = row
        return rows


@pytest.fixture
def terminal(monkeypatch) -> Terminal:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "24")
    return Terminal()


def test_figures_are_those_of_the_tags_in_order() -> None:
    found = headline(TAGS)
    names = ["collecting", "updating", "length", "return", "kills", "heals used", "scripted", "past", "epochs", "KL"]
    assert [figure.name for figure in found] == [*names, "entropy"]  # their texts are in what a log gets
    assert {figure.group for figure in found} == set(GROUPS)
    tags = {"wins/past": 0.5, "games/past": 310.0, "rating/past": 1040.4, "rating/self": 905.6}
    assert [figure.text for figure in headline(tags)] == ["50 % (310, Elo 1040)", "906"]
    for value in (math.nan, math.inf, -math.inf):
        assert headline({"rollout/steps": value, "wins/past": value, "rollout/kills0": value}) == []
        assert headline({"wins/past": 0.5, "games/past": value}) == [Figure("wins", "past", 0.5, "50 %")]


def test_the_terminal_shows_a_bar_and_a_line_for_each_group(terminal: Terminal) -> None:
    view = LiveView(1_000_000, 10_000_000, file=terminal)
    view.now("collecting")
    assert re.fullmatch(r" 10% \|\S+ +\| 1.00M of 10.0M \[.* left, .*, collecting\]", terminal.rows()[0])
    view.update(4_500_000, 10_000_000, TAGS)
    view.update(4_500_000, 10_000_000, {"train/epochs": 3.25})  # the others stay
    view.now("epoch 3")
    bar, *lines = terminal.rows()
    assert (bar[:4], bar[-9:]) == (" 45%", " epoch 3]")
    assert len(bar) == 99
    assert lines == [
        "speed     collecting 90.1k/s · updating 36.5k/s",
        "episodes  length 812 · return 400.0 / 420.0 · kills 0.75 · heals used 2.70",
        "wins      scripted 12 % (310) · past 55 %",
        "learning  epochs 3.2 · KL 0.0113 · entropy 4.21",
    ]
    assert terminal.row == 0


@pytest.mark.parametrize(("columns", "lines"), [(200, 50), (72, 10), (60, 24), (30, 10), (12, 4), (5, 2), (2, 1)])
def test_it_stays_within_any_terminal(terminal: Terminal, monkeypatch, columns: int, lines: int) -> None:
    """Where it is closed, texts go on below it, and nothing is drawn any more."""
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("LINES", str(lines))
    LiveView(0, 10, quiet=True, file=terminal).update(5, 10, TAGS)
    assert terminal.getvalue() == ""
    view = LiveView(0, 10_000_000, file=terminal)
    view.update(4_500_000, 10_000_000, TAGS)
    view.now("collecting")
    assert all(len(row) < columns for row in terminal.rows())
    assert len(terminal.rows()) <= max(1, lines - 1)
    view.close()
    terminal.write("done")
    rows = terminal.rows()
    assert len(rows) <= max(1, lines - 1) + 1
    assert (rows[-1], "collecting" in rows[0]) == ("done", False)
    view.close()
    view.update(100, 100, TAGS)
    view.now("nothing")
    assert terminal.rows() == rows


def test_messages_are_written_above_it(terminal: Terminal, monkeypatch) -> None:
    monkeypatch.setattr("sys.stderr", terminal)
    with messages_shown():
        view = LiveView(0, 100)
        view.update(10, 100, TAGS)
        logging.getLogger("outlast.training").warning("no room for a film")
        view.now("epoch 1")
        rows = terminal.rows()
        view.close()
    assert rows[0] == "outlast: no room for a film"
    assert (rows[1][:4], rows[2][:5], len(rows)) == (" 10%", "speed", 6)


def test_a_log_gets_a_line_now_and_then(monkeypatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    file = io.StringIO()
    view = LiveView(1_000_000, 2_000_000, file=file)
    for k in range(1, 8):
        clock[0] += progress.EVERY / 3
        view.now("collecting")
        view.update(1_000_000 + 100_000 * k, 2_000_000, TAGS)
    view.close()
    view.close()
    lines = file.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["1.10M", "1.40M", "1.70M"]  # and nothing twice
    assert lines[0] == (
        "1.10M of 2.00M agent-steps; 10.0k/s, 01:30 left; speed: collecting 90.1k/s, updating 36.5k/s; episodes: "
        "length 812, return 400.0 / 420.0, kills 0.75, heals used 2.70; wins: scripted 12 % (310), past 55 %; "
        "learning: epochs 3.2, KL 0.0113, entropy 4.21"
    )
    for total, expected in ((4, "1 of 4 matches; 03:00 left; between friends\n"), (0, "1 matches; between friends\n")):
        with Progress(total, "matches", file=(slow := io.StringIO())) as shown:  # without a rate, or a total
            clock[0] += 60
            shown.add(note="between friends")
        assert slow.getvalue() == expected


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "teams_3-original-0"
    made.mkdir()
    return made


@pytest.fixture
def watched(folder: Path, monkeypatch) -> Iterator[RunWatcher]:
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
    shutil.copy(policy, folder / "new")
    return (folder / "new").replace(folder / CHECKPOINT.format(steps))


def whole(watcher: RunWatcher) -> bool:
    return bool(watcher.recorded and watcher.recorded["whole"])


def until(watcher: RunWatcher, condition: Callable[[Any], bool]) -> Any:
    deadline = time.monotonic() + 60
    while not condition(status := watcher.status()):
        assert time.monotonic() < deadline, status
        time.sleep(0.02)
    return status


def log(folder: Path, *rows: tuple[str, int, float]) -> Path:
    path = folder / "log.csv"
    path.write_text("\n".join([",".join(HEADING), *(f"{tag},{step},{value}" for tag, step, value in rows), ""]))
    return path


def test_it_waits_for_the_first_checkpoint_and_plays_it(watched: RunWatcher, folder: Path, policy: Path) -> None:
    status = watched.status()
    assert status["message"] == f"{folder} has no checkpoint yet: the first one will be played."
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


def test_only_the_first_episode_grows(watched: RunWatcher, folder: Path, policy: Path, monkeypatch) -> None:
    """A page has a picture after the first tick, and need not wait for a whole episode."""
    published, published_as = list[tuple[int, int, bool]](), watch._published

    def note(known: Any, *recorded: Any, **more: Any) -> Any:
        made = published_as(known, *recorded, **more)
        published.append((made["number"], made["ticks"], made["whole"]))
        return made

    monkeypatch.setattr(watch, "_published", note)
    add(folder, 1024, policy)
    until(watched, lambda status: whole(watched))
    time.sleep(0.3)
    assert published[-1] == (1, 41, True)  # as nobody has taken it
    first = watched.episode()
    until(watched, lambda status: status["episode"]["number"] == 2)
    assert first is not None
    assert watched.episode()["data"] != first["data"]
    beginnings = [(1, ticks, False) for ticks in (1, 2, 4, 8, 16, 32)]
    assert published[:8] == [*beginnings, (1, 41, True), (2, 41, True)]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"x" * 1000], ids=["empty", "cut", "noise"])
def test_a_broken_checkpoint_is_reported(watched: RunWatcher, folder: Path, policy: Path, content: bytes) -> None:
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
    shutil.rmtree(folder)
    assert watched.status()["message"] == f"The folder {folder} does not exist any more."
    assert watched.episode() is not None


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


def test_curves_are_thinned_together_and_nothing_is_lost_where_few_episodes_end(folder: Path) -> None:
    """Sums over sides are of the same steps, although a rollout lacks a side."""
    rows = [(f"rollout/kills{side}", k, 1.0) for k in range(1, 301) for side in (0, 1, 2) if (side, k) != (2, 150)]
    (kills,) = [each for each in figures(read_log(log(folder, *rows))) if each["name"] == "kills"]
    assert [(step, value) for step, value in kills["points"] if value != 3] == [(150, pytest.approx(8 / 3))]
    assert len(kills["points"]) <= watch.POINTS
    rows = [("train/entropy", k, 5.0) for k in range(1, 601)]
    rows += [("rollout/steps", k, 1.0 * k) for k in range(6, 601, 6)]
    (length,) = [each for each in figures(read_log(log(folder, *rows))) if each["name"] == "length"]
    assert length["points"] == [(k, k) for k in range(6, 601, 6)]


def test_a_log_is_waited_for_and_read_again_when_it_has_changed(folder: Path, monkeypatch) -> None:
    path, watcher, reads = folder / "log.csv", RunWatcher(folder), list[Path]()
    for text in ("", "tag,step,value\n"):
        path.write_text(text)
        assert (watcher.status()["figures"], "is not the log" in watcher.status()["message"]) == ([], False)
    path.unlink()
    RunLog(folder, 0).close()
    assert path.read_text() == "tag,step,value\n"  # while the run collects its first rollout
    monkeypatch.setattr(watch.curves, "read_log", lambda path: reads.append(path) or read_log(path))
    log(folder, ("rollout/steps", 10, 100.0))
    texts = [watcher.status()["figures"][0]["text"] for _ in range(3)]
    log(folder, ("rollout/steps", 10, 100.0), ("rollout/steps", 20, 200.0))
    assert [*texts, watcher.status()["figures"][0]["text"]] == ["100", "100", "100", "200"]
    assert len(reads) == 2
    path.write_text(path.read_text() + "rollout/ste")  # half a row, which the run is writing
    assert watcher.status()["figures"][0]["text"] == "200"
    path.write_text("nonsense")
    status = watcher.status()
    assert ("is not the log of a run" in status["message"], status["figures"][0]["text"]) == (True, "200")


outlast_watch = partial(call, command, "--no-browser")


def test_a_folder_with_one_run_stands_for_it(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    (tmp_path / "b/run.json").touch()
    assert command._run_in(tmp_path) == command._run_in(tmp_path / "b") == tmp_path / "b"


def test_folders_that_are_no_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"folder .*nowhere does not exist"):
        outlast_watch(tmp_path / "nowhere")
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").touch()
    with pytest.raises(TrainingError, match=rf"holds several runs; choose one: {tmp_path}/a, {tmp_path}/b$"):
        outlast_watch(tmp_path)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return as_checkpoint("teams_3/original-0", tmp_path_factory.mktemp("run") / "steps_0000001024.zip")


@pytest.fixture(autouse=True)
def short(monkeypatch) -> None:
    monkeypatch.setattr(film, "MOST", 60)


def test_an_episode_is_played_to_its_end_and_is_the_same_again(policy: Path) -> None:
    paths = []
    for seed in (3, 3, 4):
        with episode(policy, seed=seed, most=5000) as played:
            places = [played.worlds[Body].x[0].copy() for _ in played.ticks]
        paths.append(np.array(places))
        assert (played.scenario.name, played.differs) == ("teams_3", "")
    assert 10 < len(paths[0]) < 5000
    assert np.array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0][:5], paths[2][:5])
    with episode(policy, seed=0, most=7) as played:  # it goes on, and is left
        assert list(played.ticks) == list(range(8))


def test_the_scenario_of_a_run_is_in_its_header_and_a_difference_is_reported() -> None:
    for scenario in (
        variant("ffa_1"),
        variant("teams_2+health_cap+bounty").replace(melee_damage=7, safe_zone_radii=(8.0, 4.0)),
        variant("ffa_3+steering").replace(n_agents=5, cameras_mode="revealed"),
    ):
        made, differs = recorded_scenario({"scenario": fingerprint(scenario), "modules": classes(scenario)})
        assert difference(fingerprint(scenario), fingerprint(made)) == differs == ""
    header = policy_file.read_header(KEPT / "ffa_1/original-0.safetensors", ())
    del header["scenario"]["numbers"]["give_last_passes_on"]
    made, differs = recorded_scenario(header)
    assert made.name == "ffa_1"
    assert differs == "give_last_passes_on is not there there and False here"


def test_mechanics_of_others_are_used_where_they_are_imported(monkeypatch) -> None:
    """Of a file that was imported twice, those that are there now."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "docs/examples"))
    import tag

    game = tag.TAG
    monkeypatch.delitem(sys.modules, "tag")  # which is put back at the end
    importlib.import_module("tag").Stamina.registered.clear()
    monkeypatch.setitem(sys.modules, "tag", tag)
    header = {"scenario": fingerprint(game.replace(stamina_most=7)), "modules": classes(game)}
    made, differs = recorded_scenario(header)
    assert (made.name, made.numbers()["stamina_most"], differs) == ("tag-stamina_most=7", 7, "")
    monkeypatch.delitem(sys.modules, "tag")
    with pytest.raises(TrainingError, match=r"tag\.\w+ is not one of outlast's own.*--import FILE\.py"):
        recorded_scenario(header)
    assert "tag" not in sys.modules


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"numbers": {"melee_damage": "much"}}, "melee.damage = 'much'"),
        ({"numbers": {"agents_count": 10**9}}, "cannot be rebuilt from a checkpoint"),
        ({"numbers": {"physics_substeps": 10**9}}, "physics.substeps = 1000000000: must be"),
    ],
)
def test_a_scenario_that_cannot_be_made_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(TrainingError, match=words):
        recorded_scenario({"scenario": fingerprint(variant("ffa_2")) | change, "modules": classes(variant("ffa_2"))})


def test_films_of_one_seed_begin_in_the_same_world_of_the_scenario_that_is_given(policy: Path, tmp_path: Path) -> None:
    ours = variant("teams_3").replace(ending_limit=20)
    end = 1 + round(HOLD * film.FPS)  # frames that show the end, which is no third tick
    for scenario, count in ((None, film.MOST // film.EVERY + 1), (ours, 20 // film.EVERY + 1 + end)):
        (path,) = film_checkpoint(policy, tmp_path / "films", scenario)
        read = cv2.VideoCapture(str(path))
        assert (read.get(cv2.CAP_PROP_FRAME_COUNT), read.get(cv2.CAP_PROP_FRAME_WIDTH)) == (count, film.SIZE)
    assert [*path.parent.iterdir()] == [path] == [tmp_path / "films/steps_0000001024.webm"]
    firsts = []
    for k in range(2):
        path = KEPT / f"ffa_2/original-{k}.safetensors"
        read = cv2.VideoCapture(str(film_checkpoint(path, tmp_path)[0]))
        firsts.append(read.read()[1][30:])  # below the title, which has the checkpoint's name
    assert np.array_equal(*firsts)


def test_what_goes_wrong_is_logged_and_ends_nothing(tmp_path: Path, caplog, monkeypatch) -> None:
    def fail(*_: Any) -> None:
        raise errors[-1]

    errors: list[Exception] = [OSError(28, "No space left on device"), films.FilmError("cut short")]
    broken, policy = tmp_path / "steps_1.zip", KEPT / "ffa_2/original-0.safetensors"
    with caplog.at_level(logging.WARNING, "outlast"):
        for content in (b"", b"PK", b"not a checkpoint"):
            broken.write_bytes(content)
            assert film_checkpoint(broken, tmp_path) == []
        assert film_checkpoint(policy, broken / "films") == []
        monkeypatch.setattr(films, "_verify", fail)
        while errors:
            assert film_checkpoint(policy, tmp_path) == []
            assert str(errors.pop().args[-1]) in caplog.text
    monkeypatch.setattr(films, "_verify", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        film_checkpoint(policy, tmp_path)
    assert caplog.text.count("no film of") == 6
    assert [path.name for path in tmp_path.iterdir()] == ["steps_1.zip"]
