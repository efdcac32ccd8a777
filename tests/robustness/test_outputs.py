"""Files that are written: all are checked ahead of the first, links are followed, nothing blocks what comes next."""

import contextlib
import os
from pathlib import Path

import pytest

from outlast.envs.storage import atomic_write


def test_names_may_be_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    target = tmp_path / ("ä" * 125 + ".txt")
    with atomic_write.atomic_write(target) as place:
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
    monkeypatch.setattr(atomic_write.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(atomic_write.time, "sleep", lambda seconds: clock.append(clock.pop() + seconds))
    monkeypatch.setattr(os, "replace", replace)
    target = tmp_path / "run.json"
    target.write_text("old")
    refused = pytest.raises(PermissionError, match=r"Access is denied; another program has it open: '.*run\.json'")
    with refused if times > 3 else contextlib.nullcontext(), atomic_write.atomic_write(target) as place:
        place.write_text("new")
    assert target.read_text() == ("old" if times > 3 else "new")
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
    assert (len(calls) == 4) or clock[0] > atomic_write.PATIENCE
