"""Readers of JSON that run out of memory or of stack: an error about the file, not about this process."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast import variant
from outlast.envs import levels
from outlast.envs.errors import MessageError, RecordingError, ScenarioError
from outlast.envs.recording import Recording
from outlast.envs.recording.container import HEAD, MAGIC, encode_chunk
from outlast.envs.scenarios.floor_plan import FloorPlan
from outlast.envs.scenarios.roles_file import with_roles
from outlast.envs.web.play import messages
from outlast.training.base import curves, run_header
from outlast.training.base.errors import TrainingError
from outlast.training.base.files import packed
from outlast.training.benchmark import result

DEEP = "{" + '"a":[' * 100_000
Reader = tuple[Callable[[Path], Any], type[Exception], str]


def recording(path: Path) -> Any:
    path.write_bytes(MAGIC + encode_chunk(HEAD, DEEP.encode(), 0, 0))
    return Recording.open(path)


def kept_curves(path: Path) -> Any:
    path.write_bytes(packed(f"# {DEEP}"))
    return curves.read_curves(path)


def run(path: Path) -> Any:
    return run_header.parse_header(path, path.read_bytes(), ())


READERS: dict[str, Reader] = {
    "levels": (lambda path: levels.load(path, variant("ffa_2")), ScenarioError, "is no file of levels"),
    "scenario": (outlast.Scenario.load, ScenarioError, "does not hold a scenario"),
    "roles": (lambda path: with_roles(variant("ffa_2"), path), ScenarioError, "does not say roles"),
    "floor plan": (FloorPlan.load, ScenarioError, "is no floor plan"),
    "recording": (recording, RecordingError, "is not a recording"),
    "message": (lambda path: messages.parse(path.read_text(), {}), MessageError, "messages are JSON"),
    "result": (result.read, TrainingError, "is no result of the benchmark"),
    "run": (run, TrainingError, "does not describe a run"),
    "curves": (kept_curves, TrainingError, "does not hold the curves of runs"),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("error", [RecursionError, MemoryError])
def test_what_a_reader_has_no_room_for_is_an_error_about_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, error: type[Exception]
) -> None:
    """RecursionError comes from a real file; memory is not really used up."""
    (read, expected, words), path = READERS[name], tmp_path / "a.json"
    path.write_text(DEEP)

    def exhausted(*given: Any, **options: Any) -> Any:
        raise MemoryError

    if error is MemoryError:
        monkeypatch.setattr(json, "loads", exhausted)
    with pytest.raises(expected, match=words):
        read(path)
