"""Writers and readers of films, for each format. Everything is streamed, not held in memory."""

import contextlib
import errno
import itertools
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FilmError, install
from ...progress import Messages
from ...storage.interrupts import children_awaited
from .. import opencv as cv2
from ..canvas import Image, png
from .apng import write_apng

FASTEST_GIF = 50  # frames per second; browsers slow down faster ones
LARGEST, LARGEST_VP8 = 2**14, 2**14 - 2  # pixels: the longest sides that H.264 and VP8 allow
LOG_ERRORS = 2  # OpenCV's log level
QUALITY = "18"  # libx264's constant rate factor: visually lossless
TO_VIDEO = ("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p")
# otherwise players guess the colours
TAGS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709")
H264 = ("-c:v", "libx264", "-crf", QUALITY, *TO_VIDEO, *TAGS, "-movflags", "+faststart")
VP9 = ("-c:v", "libvpx-vp9", "-b:v", "0", "-crf", "40", *TO_VIDEO, *TAGS)  # small: lines and discs stay clear
LOSSLESS = ("-c:v", "libx264rgb", "-crf", "0", "-preset", "ultrafast")
PALETTE = "[0:v]palettegen[colors];[1:v][colors]paletteuse=dither=none:diff_mode=rectangle"


@dataclass(frozen=True)
class Codec:
    """A format. write(path, frames, fps): frames are uint8 (height, width, 3) RGB, of one size, at least one.

    read(path): how many frames the file holds, their height and width; all of it is read. even: sides are padded
    to even numbers of pixels. extra: it needs the optional library imageio-ffmpeg. fastest: frames a second, at most.
    largest: pixels, sides at most.
    """

    write: Callable[[Path, Iterator[Image], int], None]
    read: Callable[[Path], tuple[int, int, int]]
    even: bool = False
    extra: bool = False
    fastest: int = 1000
    largest: int = LARGEST


def write_folder(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write numbered PNGs to a new folder; fps is not kept."""
    path.mkdir()
    for k, frame in enumerate(frames):
        (path / f"frame_{k:06}.png").write_bytes(png(frame))


def write_webm(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write VP8, by OpenCV."""
    first = next(frames)
    with _stderr_muted(), _openable(path) as name:
        writer = cv2.VideoWriter(name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP80"), fps, first.shape[1::-1])
    # no warnings: frames lost to a full disk are found by reading back
    level = cv2.utils.logging.setLogLevel(LOG_ERRORS)
    try:
        if not writer.isOpened():
            raise FilmError(f"this OpenCV cannot write VP8: {install('view')} and write .mp4")
        for frame in itertools.chain([first], frames):
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
    finally:
        writer.release()
        cv2.utils.logging.setLogLevel(level)


@contextlib.contextmanager
def _stderr_muted() -> Iterator[None]:
    """Keep the FFmpeg in OpenCV from writing to stderr; it has no switch for that.

    It warns that .webm has no tag for VP8, but finds the codec anyway; files that are cut short are found by _size.
    """
    Messages(sys.stderr).flush()
    try:
        kept = os.dup(2)
    except OSError:  # it is closed: nothing else may get its number, as FFmpeg would write into that
        kept = None
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        if kept is None:
            os.close(2)
        else:
            os.dup2(kept, 2)
            os.close(kept)
        if nowhere != 2:
            os.close(nowhere)


@contextlib.contextmanager
def _openable(path: Path) -> Iterator[str]:
    """Yield a path that OpenCV can open: one that is not UTF-8 would end the process, so its folder is replaced.

    The new path has the number of the open folder in /proc, and is valid in this context only. Only Unix has names
    that are not UTF-8, and only systems with /proc can do this.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            yield f"/proc/self/fd/{folder}/{path.name}"
        finally:
            os.close(folder)
    else:
        yield str(path)


def write_mp4(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write H.264 that every browser plays, by FFmpeg."""
    _encode(path, frames, fps, H264)


def write_gif(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write a GIF with one palette for all frames, which are kept on disk until it is chosen; no dithering."""
    lossless = path.with_name("whole.mkv")
    _encode(lossless, frames, fps, LOSSLESS)
    _ffmpeg(path, "-i", lossless.name, "-i", lossless.name, "-filter_complex", PALETTE, "-fps_mode", "passthrough")
    lossless.unlink()


def compress(film: Path, path: Path) -> None:
    """Write a film, any but a folder or .apng, as a .webm that is small while all is clear to see: VP9, by FFmpeg.

    Raises FilmError if FFmpeg is not installed, or fails.
    """
    _ffmpeg(path, "-i", str(film.absolute()), *VP9)


def read_folder(path: Path) -> tuple[int, int, int]:
    """Return the number of frames, height and width of a folder of pictures."""
    files = (np.frombuffer(file.read_bytes(), np.uint8) for file in sorted(path.iterdir()))
    pictures = (cv2.imdecode(file, cv2.IMREAD_COLOR) if file.size else None for file in files)
    return _size([() if picture is None else picture.shape for picture in pictures])


def read_video(path: Path) -> tuple[int, int, int]:
    """Return the number of frames, height and width of what OpenCV decodes."""
    shapes = list[tuple[int, ...]]()
    with _stderr_muted(), _openable(path) as name:
        video = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        while (found := video.read())[0]:
            shapes.append(found[1].shape)
        video.release()
    return _size(shapes)


def _size(shapes: list[tuple[int, ...]]) -> tuple[int, int, int]:
    """Return number, height and width of pictures. Raises ValueError if they do not all have the same shape."""
    if len(set(shapes)) > 1:
        raise ValueError(f"its frames have the shapes {sorted(set(shapes))}")
    height, width, _ = shapes[0] if shapes and shapes[0] else (0, 0, 0)
    return len(shapes), height, width


CODECS = {
    "": Codec(write_folder, read_folder),
    ".mp4": Codec(write_mp4, read_video, even=True, extra=True),
    ".webm": Codec(write_webm, read_video, even=True, largest=LARGEST_VP8),
    ".gif": Codec(write_gif, read_video, extra=True, fastest=FASTEST_GIF),
    ".apng": Codec(write_apng, read_video),
}
"""By the suffix of the path; without one it is a folder of pictures."""


def find_ffmpeg(suffix: str) -> str:
    """Return the path of the program that comes with imageio-ffmpeg. Raises FilmError."""
    try:
        return str(import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ModuleNotFoundError, RuntimeError) as error:
        raise FilmError(
            f"{suffix} needs FFmpeg: {install('view')}; or write .webm or .apng, which need nothing"
        ) from error


def _encode(path: Path, frames: Iterator[Image], fps: int, options: tuple[str, ...]) -> None:
    """Feed frames to FFmpeg as they come."""
    first = next(frames)
    height, width = first.shape[:2]
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-")
    _ffmpeg(path, *raw, *options, frames=itertools.chain([first], frames))


@children_awaited()
def _ffmpeg(path: Path, *options: str, frames: Iterable[Image] = ()) -> None:
    """Run FFmpeg in the folder of `path`, to write that file. The terminal's Ctrl-C does not reach it."""
    command = [find_ffmpeg(path.suffix), "-y", "-loglevel", "error", *options, path.name]
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=output, stderr=output, cwd=path.parent, start_new_session=True
        )
        pipe: Any = process.stdin
        try:
            with contextlib.suppress(BrokenPipeError):  # FFmpeg has ended; its status gives the reason
                for frame in frames:
                    pipe.write(np.ascontiguousarray(frame).data)
                pipe.close()
            process.wait()
        except BaseException:
            process.kill()
            process.wait()
            raise
        finally:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
        if process.returncode:
            output.seek(0)
            code = process.returncode
            status = f"status {code}" if code > 0 else f"ended by a signal: {signal.strsignal(-code)}"
            lines = output.read().decode(errors="replace").strip().splitlines() or [status]
            if os.strerror(errno.ENOSPC) in lines[-1]:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            raise FilmError(f"FFmpeg failed: {lines[-1]}")
