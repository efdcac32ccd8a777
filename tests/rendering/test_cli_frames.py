"""outlast frames: pictures and films from the command line."""

import os
import re
from pathlib import Path

import pytest

from outlast.envs.cli import main as cli
from tests.conftest import run
from tests.helpers.outputs import pictures

SMALL = ("--size", "64", "--steps", "4", "--quiet")
BARE = "--views=-title,-scores,-feed"


def test_without_a_number_of_steps_a_film_ends_soon(capsys, tmp_path: Path) -> None:
    """The README's first film: 1.4 MB, where its 16 worlds of 500 steps were 18 MB."""
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    arguments = re.search(r"^outlast frames (.* --mosaic 2x2 .*--out) film.webm ", readme, re.MULTILINE)
    assert arguments
    size = ("--size", 64, "--quiet")
    status, out, _ = run(capsys, "frames", *arguments[1].split(), tmp_path / "film.webm", *size)
    assert status == 0
    assert "151 frames" in out


@pytest.mark.parametrize(
    ("options", "shape"),
    [
        ((), (64, 64)),
        (("--worlds", 3), (129, 129)),
        (("--mosaic", "1x3"), (64, 194)),
        (("--mosaic", "2x1", "--worlds", 5), (129, 64)),
        (("--mosaic", "1x2", "--worlds", 1), (64, 129)),
    ],
)
def test_mosaics(capsys, tmp_path: Path, options: tuple[object, ...], shape: tuple[int, int]) -> None:
    """Without one it is nearly a square; of more worlds than it has room for, it shows the first."""
    run(capsys, "frames", "ffa_3", "--out", tmp_path / "frames", *SMALL, BARE, *options)
    assert pictures(tmp_path / "frames").shape == (5, *shape, 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("ffa_3", "--out", "film.avi"), ("film.avi", ".mp4, .webm, .gif, .apng")),
        (("ffa_3", "--out", "nowhere/film.webm"), ("there is no folder nowhere",)),
        (("ffa_3", "--out", "f.webm", "--views", "+vison"), ("no layer 'vison'", "did you mean vision")),
        (("ffa_3", "--out", "f.webm", "--size", "32"), ("size = 32", "64 to 4096")),
        (("ffa_3", "--out", "f.webm", "--fps", "5000"), ("fps = 5000",)),
        (("ffa_3", "--out", "pictures", "--fps", "10"), ("fps = 10: for films only; pictures is a folder",)),
        (("ffa_9", "--out", "f.webm"), ("ffa_9", "did you mean")),
    ],
)
def test_mistakes_are_reported_in_one_line(capsys, tmp_path: Path, monkeypatch, arguments, words) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = run(capsys, "frames", *arguments, "--quiet")
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
    assert os.listdir(tmp_path) == []


def test_a_mosaic_is_refused_before_its_worlds_are_made(capsys, tmp_path: Path) -> None:
    command = ("frames", "ffa_3", "--out", tmp_path / "film.webm", "--size", 64, "--mosaic", "2000000x1000000")
    status, _, text = run(capsys, *command)
    assert (status, "is wider than 16384: take a smaller size" in text) == (2, True)


@pytest.mark.parametrize("text", ["4", "x", "0x3", "2x-1", "axb"])
def test_mosaics_that_cannot_be(capsys, text: str) -> None:
    with pytest.raises(SystemExit):
        cli.main(("frames", "ffa_3", "--out", "film.webm", "--mosaic", text))
    assert f"{text}: rows x columns are needed, as in 4x4" in capsys.readouterr().err
