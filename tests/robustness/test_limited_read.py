"""Files from elsewhere that are huge, never end, or nest too deep: each reader stops, and its error names the file."""

import contextlib
import lzma
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import outlast
from outlast import levels
from outlast.ecs import NumberError
from outlast.envs.cli.main import main
from outlast.envs.errors import MessageError, RecordingError, ScenarioError
from outlast.envs.recording.file_format import DONE, HEAD, MAGIC, encode_chunk
from outlast.envs.scenarios.floor_plan import FloorPlan
from outlast.envs.scenarios.parse import with_roles
from outlast.envs.storage import inputs
from outlast.envs.web import game as messages
from outlast.training.base import curves, policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed
from outlast.training.benchmark import result

VARIANT = outlast.variant("ffa_2")


def _run_folder(path: Path) -> None:
    path.replace(path.with_name(policy_file.RUN_JSON))
    policy_file.read_run_folder(path.parent)


def _games(path: Path) -> None:
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    from outlast.training.benchmark.games import Moves

    Moves.read(path)


def _policy(path: Path, suffix: str = "") -> None:
    for library in ("torch", "safetensors"):
        pytest.importorskip(library, reason=f"needs {library}: outlast[train]")
    outlast.load_policy(path.replace(path.with_suffix(suffix)))


READERS: dict[str, tuple[Callable[[Path], object], int]] = {  # and bytes of a file that is too large
    "roles": (lambda path: with_roles(VARIANT, path), 2**24 + 1),
    "levels": (lambda path: levels.load(path, VARIANT), 2**24 + 1),
    "scenario": (outlast.Scenario.load, 2**24 + 1),
    "floor plan": (FloorPlan.load, 2**20 + 1),
    "run.json": (_run_folder, 2**20 + 1),
    "result.json": (result.read, 2**24 + 1),
    "games": (_games, 2**24 + 1),
    "policy": (_policy, 2**30 + 1),
    "weights": (lambda path: _policy(path, ".safetensors"), 2**26 + 1),
}


@pytest.mark.parametrize("name", READERS)
def test_a_file_has_a_limit(tmp_path: Path, name: str) -> None:
    read, size = READERS[name]
    path = tmp_path / "given"
    path.touch()
    os.truncate(path, size)
    with pytest.raises(ValueError, match=f"{tmp_path}.*it has more than {size - 1:,} bytes"):
        read(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs a device that never ends")
def test_a_file_that_never_ends_is_not_read_to_its_end() -> None:
    with pytest.raises(ValueError, match=r"/dev/zero.* it has more than"):
        outlast.Scenario.load(Path("/dev/zero"))


DEEP = '{"a":[' * 100_000


def _recording(path: Path) -> None:
    path.write_bytes(MAGIC + encode_chunk(HEAD, DEEP.encode(), 0, 0))
    outlast.Recording.open(path)


def _curves(path: Path) -> None:
    path.write_bytes(packed(f"# {DEEP}"))
    curves.read_curves(path)


MORE: dict[str, Callable[[Path], object]] = {
    "recording": _recording,
    "message": lambda path: messages.parse(path.read_text(), {}),
    "curves": _curves,
}
NESTED: dict[str, tuple[type[Exception], str]] = {
    "levels": (ScenarioError, "is not a file of levels"),
    "scenario": (ScenarioError, "does not hold a scenario"),
    "roles": (ScenarioError, "does not hold roles"),
    "floor plan": (ScenarioError, "is not a floor plan"),
    "recording": (RecordingError, "is not a recording"),
    "message": (MessageError, "messages are JSON"),
    "result.json": (TrainingError, "is not a result of the benchmark"),
    "run.json": (TrainingError, "does not describe a run"),
    "curves": (TrainingError, "does not hold the curves of runs"),
}


@pytest.mark.parametrize("name", NESTED)
def test_json_that_nests_too_deep_is_an_error_about_the_file(tmp_path: Path, name: str) -> None:
    (expected, words), path = NESTED[name], tmp_path / "a.json"
    path.write_text(DEEP)
    with pytest.raises(expected, match=words):
        (MORE.get(name) or READERS[name][0])(path)


def test_the_log_of_a_run_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = pytest.importorskip("outlast.training.base.files", reason="needs torch: outlast[train]")
    monkeypatch.setattr(files, "LARGEST", 10)
    (tmp_path / "log.csv").write_text("tag,step,value\n")
    with pytest.raises(ValueError, match=r"log\.csv cannot be read: it has more than 10 bytes"):
        files.read_text(tmp_path / "log.csv")


def test_a_chunk_of_a_recording_has_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("outlast.envs.recording.file_format.LARGEST_CHUNK", 100)
    path = tmp_path / "a.rec"
    path.write_bytes(MAGIC + encode_chunk(HEAD, os.urandom(200), 0, 0) + encode_chunk(DONE, b"", 0, 0))
    with pytest.raises(RecordingError, match=r"a\.rec: the chunk at byte 20 has 2\d\d bytes; at most 100 are possible"):
        outlast.Recording.open(path)


def test_text_is_read_as_python_reads_it(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes("ä\r\nb\rc\n".encode())
    assert inputs.read_text(tmp_path / "a") == (tmp_path / "a").read_text(encoding="utf-8") == "ä\nb\nc\n"
    assert len(inputs.read_bytes(tmp_path / "a", 8)) == 8
    with pytest.raises(ValueError, match="it has more than 7 bytes"):
        inputs.read_bytes(tmp_path / "a", 7)


def test_what_an_xz_file_holds_has_a_limit() -> None:
    content = lzma.compress(bytes(2**20))
    assert inputs.unpack_xz(content, 2**20) == bytes(2**20)
    with pytest.raises(ValueError, match="it holds more than 1,048,575 bytes"):
        inputs.unpack_xz(content, 2**20 - 1)
    for broken in (b"text", lzma.compress(b"text")[:-2], lzma.compress(b"text")[:-5] + bytes(5)):
        with pytest.raises(ValueError, match="it is not an xz file: "):
            inputs.unpack_xz(broken)


def test_a_plan_that_is_played_in_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """However large its room is: only whether agents can get everywhere is then not found out."""
    path, picture = tmp_path / "plan.json", tmp_path / "plan.png"
    FloorPlan(walls=[(0, 0, 6, 0.4)], width=600, height=600).save(path)
    assert main(["layout", str(path), "--size=64", "--out", str(picture)]) == 0
    assert "agents can get everywhere was not found out: parts: a disc of 1 m on a floor" in capsys.readouterr().err
    assert picture.exists()
    scenario = VARIANT.with_(FloorPlan.load(path).mechanic())
    with contextlib.closing(outlast.make_vec(scenario, 1, seed=0)) as env:
        env.reset()
        env.step(np.ones((1, 2, 6), int))


def test_levels_name_what_varied_when_they_were_saved(tmp_path: Path) -> None:
    """What stands in a file is read: it explains why a level does not fit."""
    path = tmp_path / "a.json"
    before, now = (VARIANT.vary(melee_damage=outlast.distributions.integers(5, most)) for most in (20, 10))
    levels.save(path, before, [levels.Level({"melee_damage": 15})])
    with pytest.raises(NumberError, match=r"in the scenario that it was saved for, melee_damage=.*20.* varied"):
        levels.load(path, now)
    for varied in ("3", "[]", '{"melee_damage": 3}'):
        path.write_text(f'{{"version": 1, "varied": {varied}, "levels": []}}')
        with pytest.raises(ScenarioError, match=r"is not a file of levels: what varied is not given as texts by"):
            levels.load(path, before)
