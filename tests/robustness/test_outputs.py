"""Files that are written: all are checked ahead of the first, links are followed, nothing blocks what comes next."""

import contextlib
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.cli import main as cli
from outlast.envs.cli.options import Output
from outlast.envs.errors import RecordingError, UsageError
from outlast.envs.rendering.films import write_film
from outlast.envs.rollout import table_file
from outlast.envs.storage import outputs
from outlast.envs.storage.outputs import check_file, check_folder
from tests.conftest import run

WRITTEN = {"out", "keep", "html", "data", "events", "csv", "json", "record", "save_scenario"}
OUTPUTS = {  # of commands
    "rollout ffa_1 --steps=5 --quiet": "record=a.rec csv=a.csv events=b.csv json=a.json save-scenario=b.json",
    "replay {folder}/given.rec --quiet --size=64": "out=a.apng html=a.html data=a.parquet events=b.parquet",
    "frames ffa_1 --steps=2 --quiet --size=64": "out=pictures save-scenario=b.json",
    "layout maze --size=64": "out=a.png save-scenario=b.json",
}
COMMANDS = {words: dict(f"--{each}".split("=") for each in outputs.split()) for words, outputs in OUTPUTS.items()}
CASES = [(command, option) for command, outputs in COMMANDS.items() for option in outputs]


def commands() -> dict[str, Any]:
    (found,) = (action.choices for action in cli.parser()._actions if isinstance(action.choices, dict))
    return dict(found)


@pytest.mark.parametrize("name", commands())
def test_every_option_that_names_an_output_is_checked_first(name: str) -> None:
    for action in commands()[name]._actions:
        if action.dest in WRITTEN:
            assert isinstance(action.type("name.json"), Output), action.option_strings


@pytest.mark.parametrize(("command", "option"), CASES)
def test_a_place_that_cannot_be_leaves_the_others_empty(tmp_path: Path, capsys: Any, command: str, option: str) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow: outlast[data]")
    outlast.rollout("ffa_1", worlds=2, steps=5, record=tmp_path / "given.rec")
    words, outputs = command.format(folder=tmp_path).split(), COMMANDS[command]
    for wrong in (f"none/{outputs[option]}", "given.rec"):
        given = [f"{each}={tmp_path / (wrong if each == option else name)}" for each, name in outputs.items()]
        status, out, err = run(capsys, *words, *given)
        assert (status, out, len(err.splitlines())) == (2, "", 1)
        assert [path.name for path in tmp_path.iterdir()] == ["given.rec"]
    assert run(capsys, *words, *(f"{each}={tmp_path / name}" for each, name in outputs.items()))[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {"given.rec", *outputs.values()}


@pytest.mark.parametrize("wrong", [{"csv": "none/a.csv"}, {"events": "a.txt"}, {"events": "a.parquet"}, {"csv": "."}])
def test_a_rollout_from_python_begins_no_file_if_another_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: dict[str, str]
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(table_file, "find_spec", lambda name: None if name == "pyarrow" else find(name))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError):
        outlast.rollout("ffa_1", worlds=2, steps=5, record="a.rec", **wrong)
    assert [*tmp_path.iterdir()] == []


# ---- recordings


def test_the_first_tick_is_on_disk_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.rec"
    with contextlib.closing(outlast.make_vec("ffa_1", 2, seed=0)) as env:
        recorder = outlast.record(env, path)
        assert not path.exists()
        env.reset()
        assert len(outlast.Recording.open(path)) == 1
        env.step(np.ones((2, 2, 6), int))
        assert len(outlast.Recording.open(path)) == 1  # others wait for more
        recorder.close()
    assert len(outlast.Recording.open(path)) == 2
    assert [each.name for each in tmp_path.iterdir()] == ["a.rec"]


def test_a_recording_without_ticks_is_no_file(tmp_path: Path) -> None:
    with contextlib.closing(outlast.make_vec("ffa_1", 2, seed=0)) as env, outlast.record(env, tmp_path / "a.rec"):
        pass
    assert [*tmp_path.iterdir()] == []


def test_a_recording_replaces_none_that_another_process_has_begun_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / "a.rec"
    with contextlib.closing(outlast.make_vec("ffa_1", 2, seed=0)) as env:
        recorder = outlast.record(env, path)
        path.write_text("another")
        with pytest.raises(RecordingError, match=r"a\.rec: File exists; the recording ends here\. The"):
            env.reset()
        recorder.close()
        env.reset()
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("a.rec", "another")]


# ---- links


def _pictures(path: Path) -> None:
    write_film(path, [np.zeros((64, 64, 3), np.uint8)] * 2)


def _recorded(option: str) -> Callable[[Path], object]:
    return lambda path: outlast.rollout("ffa_1", worlds=2, steps=5, **{option: path})  # type: ignore[arg-type]


def _replayed(option: str) -> Callable[[Path], object]:
    def write(path: Path) -> None:
        given = path.parent / "given.rec"
        outlast.rollout("ffa_1", worlds=2, steps=5, record=given)
        assert cli.main(["replay", str(given), f"--{option}={path}", "--quiet"]) == 0

    return write


WRITERS: dict[str, Callable[[Path], object]] = {
    "pictures": _pictures,
    "a.rec": _recorded("record"),
    "a.csv": _recorded("csv"),
    "data": _replayed("data"),
}


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
@pytest.mark.parametrize("name", WRITERS)
def test_every_writer_follows_links(tmp_path: Path, name: str) -> None:
    """Also one that leads to nothing yet; the link stays, and no temporary file does."""
    (tmp_path / "elsewhere").mkdir()
    link, target = tmp_path / name, tmp_path / "elsewhere" / name
    link.symlink_to(target)
    WRITERS[name](link)
    assert link.is_symlink()
    assert target.exists()
    assert [path.name for path in target.parent.iterdir()] == [name]


# ---- places


def test_what_is_checked_is_left_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "none" / "file")
    for place, wrong in (
        (tmp_path / "file/a.csv", "there is no folder .*file$"),
        (tmp_path / "none/a.csv", "there is no folder .*none$"),
        (tmp_path / "link", "there is no folder .*none$"),
        (tmp_path, "it is a folder"),
        (tmp_path / ("n" * 300), "File name too long"),
    ):
        with pytest.raises(UsageError, match=f"cannot be written: {wrong}"):
            check_file(place, "events", UsageError)
    with pytest.raises(UsageError, match="file exists; events never overwrite files"):
        check_file(tmp_path / "file", "events", UsageError, new=True)
    with pytest.raises(UsageError, match=r"out cannot be a folder: .*file is a file"):
        check_folder(tmp_path / "file/out", UsageError)
    for place in (tmp_path / "file", tmp_path / "new", Path(os.devnull)):
        assert check_file(place, "events", UsageError) == place
    assert check_folder(tmp_path / "a/b/c", UsageError) == tmp_path / "a/b/c"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


def test_a_folder_that_cannot_be_written_into_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a disk that is mounted for reading; the rights of a folder say nothing to root."""

    def readonly(path: Any, flags: int, *_: Any) -> int:
        raise OSError(30, "Read-only file system", str(path))

    monkeypatch.setattr(os, "open", readonly)
    with pytest.raises(UsageError, match="cannot be written: Read-only file system"):
        check_file(tmp_path / "a.csv", "events", UsageError)
    with pytest.raises(UsageError, match="cannot be written into: Read-only file system"):
        check_folder(tmp_path / "out", UsageError)


def test_names_may_be_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    target = tmp_path / ("ä" * 125 + ".txt")
    check_file(target, "texts", UsageError)
    with outputs.atomic_write(target) as place:
        place.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


# ---- Windows


@pytest.mark.parametrize("times", [3, 10**9])
def test_a_file_that_another_program_of_windows_has_open_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    real, calls = os.replace, list[Path]()

    def replace(path: Path, target: Path) -> None:
        calls.append(path)
        if len(calls) <= times:
            error = PermissionError(13, "Access is denied", str(path))
            error.winerror = 5  # type: ignore[attr-defined]
            raise error
        real(path, target)

    clock = [0.0]
    monkeypatch.setattr(outputs.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(outputs.time, "sleep", lambda seconds: clock.append(clock.pop() + seconds))
    monkeypatch.setattr(os, "replace", replace)
    target = tmp_path / "run.json"
    target.write_text("old")
    refused = pytest.raises(PermissionError, match=r"Access is denied; another program has it open: '.*run\.json'")
    with refused if times > 3 else contextlib.nullcontext(), outputs.atomic_write(target) as place:
        place.write_text("new")
    assert target.read_text() == ("old" if times > 3 else "new")
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
    assert (len(calls) == 4) or clock[0] > outputs.PATIENCE
