"""Films and folders of pictures: each is streamed to a file that is complete and was read back, or there is none."""

import contextlib
import errno
import itertools
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs.kernels.integers import is_whole

from ..errors import FilmError, install
from ..progress import Messages
from ..storage import outputs
from ..storage.interrupts import children_awaited, interrupts_held
from ..storage.outputs import check_file, check_folder, written_to
from . import opencv as cv2
from .canvas import Image, png
from .rgb import FPS

NUMBERED = re.compile(r"frame_\d{6,}\.png")
TO_VIDEO = ("-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p")
# otherwise players guess the colours
TAGS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709")
H264 = ("-c:v", "libx264", "-crf", "18", *TO_VIDEO, *TAGS, "-movflags", "+faststart")  # visually lossless
VP9 = ("-c:v", "libvpx-vp9", "-b:v", "0", "-crf", "40", *TO_VIDEO, *TAGS)  # small: lines and discs stay clear
LOSSLESS = ("-c:v", "libx264rgb", "-crf", "0", "-preset", "ultrafast")
PALETTE = "[0:v]palettegen[colors];[1:v][colors]paletteuse=dither=none:diff_mode=rectangle"
SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Codec:
    """A format. write(path, frames, fps): frames are uint8 (height, width, 3) RGB, of one size, at least one.

    read(path): the shapes of the frames that the file holds, () for one that cannot be read. even: sides are padded to
    even numbers of pixels. extra: it needs the optional library imageio-ffmpeg. fastest: frames a second, at most.
    largest: pixels, sides at most, as H.264 and VP8 allow.
    """

    write: Callable[[Path, Iterator[Image], int], None]
    read: Callable[[Path], list[tuple[int, ...]]]
    even: bool = False
    extra: bool = False
    fastest: int = 1000
    largest: int = 2**14


def write_film(path: str | os.PathLike[str], frames: Iterable[Image], fps: int = FPS) -> int:
    """Write a film, or a folder of pictures.

    It is written to a temporary file, read back, and moved into place: an error, Ctrl-C or a full disk leaves a file
    that was there before. If the path is a link, what it leads to is replaced.

    Args:
        path: .mp4 (H.264, plays everywhere) and .gif (one palette, no dithering) need `pip install 'outlast[view]'`;
            .webm (VP8) and .apng (lossless) do not. A path without a suffix, or of an existing folder, is a folder of
            pictures, frame_000000.png and so on; pictures of an earlier film in it go first.
        frames: uint8 (height, width, 3) RGB, all of one size, at least one. They are written as they come; for a .gif
            they are first kept on disk. In .mp4 and .webm, odd sizes get one more row or column.
        fps: Frames per second. A folder of pictures keeps none.

    Returns:
        The number of frames.

    Raises:
        FilmError: The path, frames or rate is not valid, FFmpeg is needed but missing, or the disk is full.
    """
    given, codec = Path(path), check_film(path, fps)
    target, shapes = Path(os.path.realpath(given)), list[tuple[int, ...]]()
    with written_to(given, FilmError), _temporary_folder(target) as folder:
        temporary = folder / f"film{ending(given)}"
        codec.write(temporary, _checked_frames(frames, codec, shapes), int(fps))
        _verify(temporary, codec, shapes, given)
        _replace(temporary, target)
    return len(shapes)


def ending(path: Path) -> str:
    """Return the film's format by its suffix, in lower case: ".webm"; "" for a folder of pictures."""
    return "" if path.is_dir() else path.suffix.lower()


def check_film(path: str | os.PathLike[str], fps: Any = FPS) -> Codec:
    """Return the codec of a film of this rate that can be written there. Raises FilmError."""
    target = Path(path)
    suffix = ending(target)
    if suffix not in CODECS:
        known = ", ".join(filter(None, CODECS))
        raise FilmError(f"{target}: a film ends in {known}; without an ending it is a folder of pictures")
    if not target.absolute().name:
        raise FilmError(f"{target}: pictures are not written into the root folder; give a folder of their own")
    if target.exists() and not suffix and not target.is_dir():
        raise FilmError(f"{target} is a file: a folder of pictures needs another name")
    if target.is_dir():
        check_folder(target, FilmError)
    else:
        check_file(target, "films", FilmError)
    codec = CODECS[suffix]
    if codec.extra:
        find_ffmpeg(suffix)
    if not is_whole(fps, 1, codec.fastest):
        raise FilmError(f"fps = {fps!r}: an integer from 1 to {codec.fastest} is needed for {suffix or 'a folder'}")
    if not suffix and fps != FPS:
        raise FilmError(f"fps = {fps}: for films only; {target} is a folder of pictures, which keeps no rate")
    return codec


def _checked_frames(frames: Iterable[Any], codec: Codec, shapes: list[tuple[int, ...]]) -> Iterator[Image]:
    """Yield frames that are checked and padded, and append the shape of each to `shapes`. Raises FilmError."""
    size: tuple[int, ...] = ()
    for k, frame in enumerate(frames):
        if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            found = f"{frame.dtype} {frame.shape}" if isinstance(frame, np.ndarray) else type(frame).__name__
            raise FilmError(f"frame {k} is {found}: uint8 (height, width, 3) is needed")
        size = size or frame.shape
        if frame.shape != size:
            raise FilmError(
                f"frame {k} has {frame.shape[1]} x {frame.shape[0]} pixels, those before it {size[1]} x {size[0]}: all "
                "need one size"
            )
        if not 0 < min(size[:2]) <= max(size[:2]) <= codec.largest:
            raise FilmError(f"frames have {size[1]} x {size[0]} pixels: 1 to {codec.largest} are possible")
        odd = [side % 2 if codec.even else 0 for side in size[:2]]
        padded = np.pad(frame, ((0, odd[0]), (0, odd[1]), (0, 0)), "edge") if any(odd) else frame
        shapes.append(padded.shape)
        yield padded
    if not shapes:
        raise FilmError("frames are missing: a film needs at least one")


@contextlib.contextmanager
def _temporary_folder(target: Path) -> Iterator[Path]:
    """Yield a folder on the same disk as the target; it is removed at the end with all that is left in it."""
    folder = outputs.temporary_path(target / target.name if target.is_dir() else target)
    folder.mkdir()
    try:
        yield folder
    finally:
        outputs.remove(folder)


def _verify(temporary: Path, codec: Codec, shapes: list[tuple[int, ...]], target: Path) -> None:
    """Read back what was written. Raises FilmError if it is not complete."""
    found = codec.read(temporary)
    if len(set(found)) > 1:
        raise FilmError(f"{target} was not written completely: its frames have the shapes {sorted(set(found))}")
    height, width = found[0][:2] if found and found[0] else (0, 0)
    if (len(found), height, width) != (len(shapes), *shapes[0][:2]):
        raise FilmError(
            f"{target} was not written completely: {len(found)} frames of {width} x {height} can be read back, "
            f"{len(shapes)} of {shapes[0][1]} x {shapes[0][0]} were written; is the disk full?"
        )


def _replace(temporary: Path, target: Path) -> None:
    """Move a film to its place: into an existing folder picture by picture, while Ctrl-C waits until all are there.

    Pictures of an earlier film go first: if this process is killed, the folder has no pictures of two films.
    """
    if not target.is_dir():
        outputs.replace(temporary, target)
        return
    with interrupts_held():
        for file in sorted(target.iterdir(), reverse=True):
            if NUMBERED.fullmatch(file.name):
                file.unlink()
        for file in sorted(temporary.iterdir()):
            outputs.replace(file, target / file.name)


def _write_folder(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write numbered PNGs to a new folder; fps is not kept."""
    path.mkdir()
    for k, frame in enumerate(frames):
        (path / f"frame_{k:06}.png").write_bytes(png(frame))


def _read_folder(path: Path) -> list[tuple[int, ...]]:
    files = (np.frombuffer(file.read_bytes(), np.uint8) for file in sorted(path.iterdir()))
    pictures = (cv2.imdecode(file, cv2.IMREAD_COLOR) if file.size else None for file in files)
    return [() if picture is None else picture.shape for picture in pictures]


def _write_webm(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write VP8, by OpenCV."""
    first = next(frames)
    with _stderr_muted(), _openable(path) as name:
        writer = cv2.VideoWriter(name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP80"), fps, first.shape[1::-1])
    # errors only, no warnings: frames lost to a full disk are found by reading back
    level = cv2.utils.logging.setLogLevel(2)
    try:
        if not writer.isOpened():
            raise FilmError(f"this OpenCV cannot write VP8: {install('view')} and write .mp4")
        for frame in itertools.chain([first], frames):
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
    finally:
        writer.release()
        cv2.utils.logging.setLogLevel(level)


def read_video(path: Path) -> list[tuple[int, ...]]:
    """Return the shapes of all frames that OpenCV decodes."""
    shapes = list[tuple[int, ...]]()
    with _stderr_muted(), _openable(path) as name:
        video = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
        while (found := video.read())[0]:
            shapes.append(found[1].shape)
        video.release()
    return shapes


@contextlib.contextmanager
def _stderr_muted() -> Iterator[None]:
    """Keep the FFmpeg in OpenCV from writing to stderr; it has no switch for that.

    It warns that .webm has no tag for VP8, but finds the codec anyway; files that are cut short are found by _verify.
    """
    Messages(sys.stderr).flush()
    with contextlib.ExitStack() as stack:
        try:
            kept = os.dup(2)
        except OSError:  # it is closed: nothing else may get its number, as FFmpeg would write into that
            stack.callback(os.close, 2)
        else:
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, 2)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != 2:
            stack.callback(os.close, nowhere)
            os.dup2(nowhere, 2)
        yield


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


def _write_apng(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write an animated PNG that plays for ever. Each frame holds the rectangle that differs from the one before.

    Source: Portable Network Graphics (PNG) Specification (Third Edition), W3C 2025, chapter 11.3.5 on animation.
    """
    with path.open("wb") as file:

        def chunk(kind: bytes, *numbers: int, data: bytes = b"") -> None:
            content = struct.pack(f">{len(numbers)}I", *numbers) + data
            file.write(struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content)))

        numbers, before, total = itertools.count(), None, 0
        for frame in frames:
            top, left, part = _changed(before, frame)
            height, width = part.shape[:2]
            if before is None:
                file.write(SIGNATURE)
                chunk(b"IHDR", width, height, data=bytes([8, 2, 0, 0, 0]))
                start = file.tell()
                chunk(b"acTL", 0, 0)
            # a frame stays where the next one does not cover it; where it does, pixels are replaced
            chunk(b"fcTL", next(numbers), width, height, left, top, data=struct.pack(">HHBB", 1, fps, 0, 0))
            for data in _pixels(part):
                if before is None:
                    chunk(b"IDAT", data=data)
                else:
                    chunk(b"fdAT", next(numbers), data=data)
            before, total = frame.copy(), total + 1
        chunk(b"IEND")
        file.seek(start)
        chunk(b"acTL", total, 0)


def _changed(before: Image | None, frame: Image) -> tuple[int, int, Image]:
    """Return top, left and pixels of the smallest rectangle with all that is new; one pixel if nothing is new."""
    if before is None:
        return 0, 0, frame
    differs = (before != frame).any(2)
    rows, columns = np.flatnonzero(differs.any(1)), np.flatnonzero(differs.any(0))
    if not len(rows):
        return 0, 0, frame[:1, :1]
    return int(rows[0]), int(columns[0]), frame[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _pixels(part: Image) -> Iterator[bytes]:
    """Yield the compressed pixels: the contents of the IDAT chunks of the PNG that OpenCV makes of this part."""
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(part[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 6])
    content, at = encoded.tobytes(), len(SIGNATURE)
    while at < len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        if kind == b"IDAT":
            yield content[at + 8 : at + 8 + length]
        at += 12 + length


def _write_mp4(path: Path, frames: Iterator[Image], fps: int, options: tuple[str, ...] = H264) -> None:
    """Write H.264 that every browser plays, by FFmpeg, which gets frames as they come."""
    first = next(frames)
    height, width = first.shape[:2]
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-")
    _ffmpeg(path, *raw, *options, frames=itertools.chain([first], frames))


def _write_gif(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write a GIF with one palette for all frames, which are kept on disk until it is chosen; no dithering."""
    lossless = path.with_name("whole.mkv")
    _write_mp4(lossless, frames, fps, LOSSLESS)
    _ffmpeg(path, "-i", lossless.name, "-i", lossless.name, "-filter_complex", PALETTE, "-fps_mode", "passthrough")
    lossless.unlink()


def compress(film: Path, path: Path) -> None:
    """Write a film, any but a folder or .apng, as a .webm that is small while all is clear to see: VP9, by FFmpeg.

    Raises FilmError if FFmpeg is not installed, or fails.
    """
    _ffmpeg(path, "-i", str(film.absolute()), *VP9)


def find_ffmpeg(suffix: str) -> str:
    """Return the path of the program that comes with imageio-ffmpeg. Raises FilmError."""
    try:
        return str(import_module("imageio_ffmpeg").get_ffmpeg_exe())
    except (ModuleNotFoundError, RuntimeError) as error:
        raise FilmError(
            f"{suffix} needs FFmpeg: {install('view')}; or write .webm or .apng, which need nothing"
        ) from error


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


CODECS = {
    "": Codec(_write_folder, _read_folder),
    ".mp4": Codec(_write_mp4, read_video, even=True, extra=True),
    ".webm": Codec(_write_webm, read_video, even=True, largest=2**14 - 2),
    ".gif": Codec(_write_gif, read_video, extra=True, fastest=50),  # browsers slow down faster ones
    ".apng": Codec(_write_apng, read_video),
}
"""By the suffix of the path; without one it is a folder of pictures."""
