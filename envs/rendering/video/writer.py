"""Writing films: a file that is complete and was read back, or none."""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs.kernels.integers import is_whole

from ...errors import FilmError
from ...storage import outputs
from ...storage.interrupts import interrupts_held
from ...storage.outputs import check_file, check_folder, written_to
from ..canvas import Image
from ..rgb import FPS
from .codecs import CODECS, Codec, find_ffmpeg

NUMBERED = re.compile(r"frame_\d{6,}\.png")


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
    if CODECS[suffix].extra:
        find_ffmpeg(suffix)
    codec = CODECS[suffix]
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
    try:
        found = codec.read(temporary)
    except ValueError as error:
        raise FilmError(f"{target} was not written completely: {error}") from error
    if found != (len(shapes), *shapes[0][:2]):
        count, height, width = found
        raise FilmError(
            f"{target} was not written completely: {count} frames of {width} x {height} can be read back, "
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
