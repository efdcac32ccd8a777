"""Films that cannot be: what is refused, a full disk, Ctrl-C and worse leave what was there before."""

import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast.envs.errors import FilmError
from outlast.envs.rendering import films
from outlast.envs.rendering.films import write_film
from tests.rendering.test_film import SUFFIXES, Image, frame, frames, needs

MISTAKES: dict[str, tuple[Any, Any, str]] = {
    "no frames": ([], 30, "at least one"),
    "sizes that change": ([frame(0), frame(1), frame(2, 96, 100)], 30, "frame 2 has 100 x 96 pixels.*128 x 96"),
    "grey": ([frame(0)[..., 0]], 30, r"frame 0 is uint8 \(96, 128\): uint8 \(height, width, 3\)"),
    "fractions": ([frame(0) / 255], 30, "frame 0 is float64"),
    "no picture": ([frame(0), None], 30, "frame 1 is NoneType"),
    "an error while drawing": (None, 30, "division"),
    "no speed": ([frame(0)], 0, "fps = 0: an integer from 1"),
    "half a frame a second": ([frame(0)], 0.5, "fps = 0.5"),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_leave_what_was_there(tmp_path: Path, suffix: str, mistake: str) -> None:
    needs(suffix)
    given, fps, message = MISTAKES[mistake]
    (path := tmp_path / "film.mp4").write_text("an earlier film")
    with pytest.raises((FilmError, ZeroDivisionError), match=message):
        write_film(tmp_path / f"film{suffix}", (frame(1 // (3 - k)) for k in range(9)) if given is None else given, fps)
    assert os.listdir(tmp_path) == ["film.mp4"]
    assert path.read_text() == "an earlier film"


@pytest.mark.parametrize(
    ("name", "fps", "message"),
    [
        ("film.avi", 30, "ends in .mp4, .webm, .gif, .apng"),
        ("nowhere/film.mp4", 30, "there is no folder"),
        ("taken", 30, "file"),
        ("film.gif", 60, r"fps = 60: an integer from 1 to 50 is needed for \.gif"),
    ],
)
def test_films_that_cannot_be(tmp_path: Path, name: str, fps: int, message: str) -> None:
    needs(Path(name).suffix)
    (tmp_path / "taken").write_text("mine")

    def never() -> Iterator[Image]:
        raise AssertionError("a frame was drawn for a path that cannot be")
        yield

    with pytest.raises(FilmError, match=message):
        write_film(tmp_path / name, never(), fps)
    assert os.listdir(tmp_path) == ["taken"]


@pytest.mark.parametrize("there", [1, 9])
def test_a_folder_never_has_pictures_of_two_films(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: int) -> None:
    """At whatever moment of its replacement this process is killed; what is not a picture stays."""
    found: list[list[bytes]] = []

    def look(*_: Any) -> None:
        found.append([file.read_bytes() for file in sorted(tmp_path.glob("frame_*.png"))])

    write_film(tmp_path, [np.zeros((64, 64, 3), np.uint8)] * there)
    (tmp_path / "notes.txt").write_text("mine")
    look()
    old = found[0][0]
    for owner, name in ((Path, "unlink"), (os, "replace")):
        real: Any = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *given, real=real, **more: (look(), real(*given, **more))[1])
    write_film(tmp_path, [np.full((64, 64, 3), 255, np.uint8)] * 5)
    look()
    monkeypatch.undo()
    assert all(set(pictures) in ({old}, {found[-1][0]}, set()) for pictures in found)
    assert [len(found[0]), len(found[-1])] == [there, 5]
    assert sorted(os.listdir(tmp_path)) == [*(f"frame_{k:06}.png" for k in range(5)), "notes.txt"]


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="other systems have no such names")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_names_that_are_not_utf_8(tmp_path: Path, suffix: str) -> None:
    """Of the folder and of the film: OpenCV would end the process, so it is one of its own."""
    needs(suffix)
    folder = tmp_path / os.fsdecode(b"d\xff")
    folder.mkdir()
    code = """
        import os, sys
        from outlast.envs.rendering.films import write_film
        from tests.rendering.test_film import frames
        there = set(os.listdir("/proc/self/fd"))
        for name in "film", os.fsdecode(b"n\\xff"):
            assert write_film(name + sys.argv[1], frames()) == len(list(frames()))
        assert set(os.listdir("/proc/self/fd")) == there
    """
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), *filter(None, sys.path)])}
    command = [sys.executable, "-c", textwrap.dedent(code), suffix]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert sorted(os.listdir(os.fsencode(folder))) == [b"film" + suffix.encode(), b"n\xff" + suffix.encode()]


def test_without_ffmpeg_the_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for suffix in (".mp4", ".gif"):
        with pytest.raises(FilmError, match=r"pip install 'outlast\[view\]'.*\.webm"):
            write_film(tmp_path / f"film{suffix}", frames())
    for suffix in (".webm", ".apng", ""):
        assert write_film(tmp_path / f"film{suffix}", frames(3)) == 3


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".gif", ".apng"])
def test_what_was_written_is_read_back(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    needs(suffix)
    codec = films.CODECS[suffix]

    def careless(path: Path, given: Iterator[Image], fps: int) -> None:
        codec.write(path, given, fps)
        path.write_bytes(path.read_bytes()[: int(0.6 * path.stat().st_size)])

    monkeypatch.setitem(films.CODECS, suffix, films.Codec(careless, codec.read, codec.even))
    with pytest.raises(FilmError, match="was not written completely"):
        write_film(tmp_path / f"film{suffix}", frames())
    assert os.listdir(tmp_path) == []
