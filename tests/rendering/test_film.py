"""Films hold what was drawn, every frame of it, as other libraries read them."""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from outlast.envs.rendering.films import compress, write_film

SUFFIXES = (".mp4", ".webm", ".gif", ".apng", "")
COUNT = 31
Image = np.ndarray[Any, Any]


def needs(suffix: str) -> None:
    if suffix in (".mp4", ".gif"):
        pytest.importorskip("imageio_ffmpeg", reason=f"{suffix} needs imageio-ffmpeg")


def frame(k: int, height: int = 96, width: int = 128) -> Image:
    image = np.full((height, width, 3), (250, 249, 246), np.uint8)
    cv2.circle(image, (20 + k, 40), 12, (0, 114, 178), -1, cv2.LINE_AA)
    cv2.rectangle(image, (60, 60), (90, 80), (213, 94, 0), -1)
    return image


def frames(count: int = COUNT, height: int = 96, width: int = 128) -> Iterator[Image]:
    return (frame(k, height, width) for k in range(count))


def decoded(path: Path, height: int, width: int) -> Image:
    """All frames by FFmpeg, which is not what reads films back; of a folder by Pillow."""
    if path.is_dir():
        pillow = pytest.importorskip("PIL.Image")
        return np.array([np.asarray(pillow.open(file)) for file in sorted(path.iterdir())])
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    command = [ffmpeg, "-loglevel", "error", "-i", path, "-fps_mode", "passthrough", "-f", "rawvideo", "-pix_fmt"]
    run = subprocess.run([*command, "rgb24", "-"], capture_output=True, check=True)
    assert not run.stderr
    return np.frombuffer(run.stdout, np.uint8).reshape(-1, height, width, 3)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_films_hold_every_frame(tmp_path: Path, suffix: str) -> None:
    needs(suffix)
    path = tmp_path / f"film{suffix}"
    assert write_film(path, frames(), 25 if suffix else 30) == COUNT
    seen, drawn = decoded(path, 96, 128), np.array(list(frames()))
    assert seen.shape == drawn.shape
    difference = np.abs(seen.astype(int) - drawn).mean((1, 2, 3))
    assert difference.max() < {".mp4": 2, ".webm": 4, ".gif": 0.5}.get(suffix, 1e-9)
    for k in range(COUNT):  # and each is the one that was drawn, not a neighbour
        distances = np.abs(seen[k].astype(int) - drawn).mean((1, 2, 3))
        assert distances.argmin() == k
    for y, x in ((5, 5), (70, 75)):  # no tint by a wrong matrix, no dithering
        patch = seen[-1, y - 3 : y + 4, x - 3 : x + 4].reshape(-1, 3).astype(int)
        assert np.abs(patch - frame(0)[y, x]).max() <= {".mp4": 3, ".webm": 8, ".gif": 2}.get(suffix, 0)
    assert [path.name] == os.listdir(tmp_path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(("height", "width"), [(65, 96), (64, 97)])
def test_odd_sizes_are_padded_where_the_codec_needs_it(tmp_path: Path, suffix: str, height: int, width: int) -> None:
    needs(suffix)
    write_film(path := tmp_path / f"film{suffix}", frames(3, height, width))
    even = suffix in (".mp4", ".webm")
    seen = decoded(path, height + height % 2 * even, width + width % 2 * even)
    assert len(seen) == 3
    assert np.abs(seen[0, :height, :width].astype(int) - frame(0, height, width)).mean() < 4


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_frame_and_frames_that_stand_still(tmp_path: Path, suffix: str) -> None:
    needs(suffix)
    assert write_film(tmp_path / f"one{suffix}", frames(1)) == 1
    assert write_film(path := tmp_path / f"still{suffix}", [frame(0)] * 7) == 7
    assert len(decoded(path, 96, 128)) == 7


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".gif"])
@pytest.mark.parametrize("fps", [10, 25, 50])
def test_films_last_as_long_as_they_should(tmp_path: Path, suffix: str, fps: int) -> None:
    needs(suffix)
    write_film(path := tmp_path / f"film{suffix}", frames(20), fps)
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(fps, rel=0.05)
    video.release()


def test_an_mp4_plays_everywhere(tmp_path: Path) -> None:
    """H.264, 4:2:0, colours tagged, its index in front: what browsers ask for."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    write_film(path := tmp_path / "film.mp4", frames())
    output = subprocess.run([ffmpeg, "-i", path], capture_output=True, text=True).stderr
    assert re.search(r"Video: h264 .*yuv420p\(tv, bt709", output)
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_a_film_is_compressed_and_holds_every_frame(tmp_path: Path) -> None:
    """VP9 with the same colours, which is smaller than what is easy to encode."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    write_film(whole := tmp_path / "film.gif", frames(), 20)
    compress(whole, path := tmp_path / "film.webm")
    assert path.stat().st_size < whole.stat().st_size / 2
    seen, drawn = decoded(path, 96, 128).astype(int), np.array(list(frames()), int)
    assert [int(np.abs(each - drawn).mean((1, 2, 3)).argmin()) for each in seen] == list(range(COUNT))
    assert np.abs(seen - drawn).mean() < 4
    output = subprocess.run([ffmpeg, "-i", path], capture_output=True, text=True).stderr
    assert re.search(r"Video: vp9 .*yuv420p\(tv, bt709", output)


def test_an_apng_is_an_animation_for_others_and_a_png_for_the_rest(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    write_film(path := tmp_path / "film.apng", frames(5), 20)
    with pillow.open(path) as image:
        assert (image.format, image.n_frames, image.info["loop"]) == ("PNG", 5, 0)
        for k in range(5):
            image.seek(k)
            assert image.info["duration"] == 50
            assert np.array_equal(np.asarray(image.convert("RGB")), frame(k))
    assert np.array_equal(cv2.imread(str(path))[..., ::-1], frame(0))


def test_a_folder_holds_numbered_pictures(tmp_path: Path) -> None:
    write_film(folder := tmp_path / "film", frames(4))
    assert sorted(os.listdir(folder)) == [f"frame_{k:06}.png" for k in range(4)]
    (folder / "notes.txt").write_text("mine")
    write_film(folder, (frame(k + 9) for k in range(2)))
    assert sorted(os.listdir(folder)) == ["frame_000000.png", "frame_000001.png", "notes.txt"]
    assert np.array_equal(cv2.imread(str(folder / "frame_000001.png"))[..., ::-1], frame(10))
