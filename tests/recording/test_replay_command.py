"""outlast replay: what it prints and writes, and what it refuses in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Health
from outlast.envs.errors import PageError, RecordingError
from outlast.envs.recording import Replay
from outlast.envs.rollout.local import rollout
from outlast.envs.rollout.policies import random_policy
from outlast.envs.web.pages import record_ticks
from tests.conftest import run


@pytest.fixture(scope="module")
def path(tmp_path_factory: Any) -> Path:
    path: Path = tmp_path_factory.mktemp("command") / "a.rec"
    env = outlast.make_vec("teams_3", 4, seed=1)
    with outlast.record(env, path):
        rollout(env, random_policy(env), 12)
    return path


ROLLOUT = ("rollout", "ffa_2", "--worlds=3", "--steps=150", "--policy=noop", "--set=safe_zone_damage=50", "--quiet")


def test_the_table_is_that_of_the_rollout(capsys: Any, tmp_path: Path) -> None:
    status, out, _ = run(capsys, *ROLLOUT, "--record", tmp_path / "a.rec")
    assert status == 0
    status, again, err = run(capsys, "replay", tmp_path / "a.rec", "--quiet")
    assert (status, err) == (0, "")
    assert "ffa_2-safe_zone_damage=50, 3 worlds, 151 ticks; every digest is the same" in again
    assert out[out.index(" episodes ended") - 2 :] == again[again.index(" episodes ended") - 2 :]
    assert "std. error" in again
    status, _, err = run(capsys, *ROLLOUT, "--record", tmp_path / "a.rec")
    assert (status, "never overwrite files" in err) == (2, True)


def test_a_difference_is_status_1(capsys: Any, path: Path, monkeypatch: Any) -> None:
    real = Replay._run

    def wrong(self: Any, record: Any) -> None:
        real(self, record)
        self.worlds[Health].points[0, 0] -= 1

    monkeypatch.setattr(Replay, "_run", wrong)
    status, out, err = run(capsys, "replay", path, "--quiet")
    assert (status, out) == (1, "")
    assert "tick 0 is the first that differs" in err
    assert "in Health;" in err
    assert len(err.strip().splitlines()) == 1
    assert run(capsys, "replay", path, "--quiet", "--no-verify")[0] == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--html", "page.txt"), "page.txt: pages are written as NAME.html"),
        (("--data", "a.parquet", "--events", "a.parquet"), "--data and --events are both a.parquet: give another name"),
        (("--html", "page.html", "--worlds", "0,4"), "world 4 does not exist; they are 0 to 3"),
        (("--html", "page.html", "--from", "9", "--to", "5"), "0 <= from <= to <= 12 is needed, the last tick of"),
        (("--html", "page.html", "--to", "999"), "0 <= from <= to <= 12"),
        (("--to", "5"), "select what is written; give --out, --html, --data or --events, too"),
        (("--html", "page.html", "--size", "64", "--fps", "9"), "--size, --fps: for pictures and films only"),
        (("--flat", "--data", "data"), "--flat is for tables of samples: give --data NAME.parquet, too"),
        (("--data", "samples.csv"), "export to .csv is not possible; give a folder without an ending"),
    ],
)
def test_mistakes_are_one_line(capsys: Any, path: Path, options: tuple[str, ...], words: str) -> None:
    status, _, err = run(capsys, "replay", path, "--quiet", *options)
    assert (status, words in err, len(err.strip().splitlines())) == (2, True, 1)


def test_a_world_has_one_number_in_options_tables_and_pages(capsys: Any, tmp_path: Path) -> None:
    """That of the recorded environment, whose worlds may begin at another one than 0."""
    env = outlast.make_vec("ffa_1", 4, seed=0, first_world=10)
    with outlast.record(env, tmp_path / "a.rec"):
        outlast.rollout(env, "random", 5)
    files = ("--data", tmp_path / "data", "--html", tmp_path / "page.html", "--worlds", "12,13", "--quiet")
    assert run(capsys, "replay", tmp_path / "a.rec", *files)[0] == 0
    assert set(np.load(tmp_path / "data" / "shard_000000.npz")["world"]) == {12, 13}
    replay = Replay(tmp_path / "a.rec")
    assert list(record_ticks(replay.worlds, replay.ticks(), [2, 3], replay)) == [12, 13]
    status, _, err = run(
        capsys, "replay", tmp_path / "a.rec", "--html", tmp_path / "b.html", "--worlds", "2", "--quiet"
    )
    assert (status, "world 2 does not exist; they are 10 to 13" in err) == (2, True)
    other = outlast.make_vec("ffa_1", 2, seed=0)
    with outlast.record(other, tmp_path / "b.rec"):
        outlast.rollout(other, "random", 5)
    pages = tmp_path / "a.rec", tmp_path / "two.html"
    assert outlast.replay_page(*pages, beside=tmp_path / "b.rec", worlds=[11], quiet=True).exists()  # its world 1
    with pytest.raises(RecordingError, match=r"b\.rec: world 3 does not exist; they are 0 to 1"):
        outlast.replay_page(*pages, beside=tmp_path / "b.rec", worlds=[13], quiet=True)
    with pytest.raises(RecordingError, match="world 3 does not exist; they are 10 to 13"):
        outlast.film(tmp_path / "a.rec", tmp_path / "a.apng", worlds=[3], size=64)


def test_frames_and_pages_show_the_chosen_worlds(capsys: Any, path: Path, tmp_path: Path) -> None:
    options = ("--worlds", "0,3", "--from", "2", "--to", "6", "--quiet")
    status, *_ = run(capsys, "replay", path, "--out", tmp_path / "frames", "--size", "64", *options)
    assert (status, len(list((tmp_path / "frames").glob("*.png")))) == (0, 5)
    status, *_ = run(capsys, "replay", path, "--html", tmp_path / "page.html", *options)
    assert status == 0
    assert (tmp_path / "page.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")


def test_a_page_does_not_replace_its_recording(path: Path, tmp_path: Path) -> None:
    (page := tmp_path / "a.html").write_bytes(path.read_bytes())
    for source, out, more, words in (
        (page, page, {}, r"a\.html is the recording itself"),
        (path, page, {"beside": page}, r"a\.html is the recording itself"),
        (path, path, {}, r"pages are written as NAME\.html"),
        (path, tmp_path / "b.html", {"title": 3}, "title = 3: a text is needed"),
    ):
        with pytest.raises(PageError, match=words):
            outlast.replay_page(source, out, **more)
    assert page.read_bytes() == path.read_bytes()
    assert len(list(tmp_path.iterdir())) == 1


def test_a_stopped_replay_makes_nothing_more(
    capsys: Any, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*arguments: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("outlast.envs.api.film.footage", stop)
    out = ("--out", tmp_path / "a.webm", "--html", tmp_path / "a.html", "--quiet")
    assert run(capsys, "replay", path, *out)[0] == 130
    assert not list(tmp_path.iterdir())
