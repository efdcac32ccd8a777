"""outlast frames: pictures and films from the command line."""

import re
from pathlib import Path

import pytest

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
