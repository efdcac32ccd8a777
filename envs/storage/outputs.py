"""Paths of files and folders to write, which are checked before any work is done for them.

All writers follow symbolic links: they replace the target of a link, and the link stays.
"""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from .atomic_write import temporary_path


@contextlib.contextmanager
def written_to(path: str | os.PathLike[str], error: type[Exception], more: str = "") -> Iterator[None]:
    """Turn errors of the disk into `error`, which names the path that is written to. more: What follows the reason."""
    try:
        yield
    except FileExistsError as reason:  # another process has written it, see atomic_write
        raise error(f"{path} exists, {reason.strerror}") from reason
    except OSError as reason:
        raise error(f"{path} cannot be written: {reason.strerror or reason}{more}") from reason


def check_file(
    path: str | os.PathLike[str], what: str, error: type[Exception], *, endings: Sequence[str] = (), new: bool = False
) -> Path:
    """Return the path of a file or folder, after checking that it can be written. Leaves no file there.

    Args:
        path: Where it goes.
        what: Its content, in the plural, for messages: "events".
        error: The class of errors.
        endings: Endings of its name that are allowed; empty: all.
        new: Whether it must not exist yet.

    Raises:
        error: It has another ending, exists although it must be `new`, is a folder, its folder does not exist, or
            nothing can be written there.
    """
    target = Path(path)
    if endings and target.suffix not in endings:
        raise error(f"{target}: {what} are written as {' or '.join(f'NAME{ending}' for ending in endings)}")
    try:
        there = target.exists()
        if there and new:
            raise error(f"{target} exists; {what} never overwrite files: give another name, or delete it")
        if target.is_dir():
            raise error(f"{target} cannot be written: it is a folder")
        real = Path(os.path.realpath(target))
        if not real.parent.is_dir():
            folder = real.parent if target.is_symlink() else target.parent
            raise error(f"{target} cannot be written: there is no folder {folder}")
        if not there or target.is_file():  # a device is written to directly
            _probe(real)
    except OSError as reason:
        raise error(f"{target} cannot be written: {reason.strerror or reason}") from reason
    return target


def check_folder(path: str | os.PathLike[str], error: type[Exception]) -> Path:
    """Return the path of a folder, after checking that it is writable, or can be created with its parents.

    Raises:
        error: It is a file, or is not writable.
    """
    target = Path(path)
    try:
        around = next(each for each in (target, *target.absolute().parents) if each.exists() or each.is_symlink())
        if not around.is_dir():
            raise error(f"{target} cannot be a folder: {around} is a file")
        _probe(Path(os.path.realpath(around)) / "probe")
    except OSError as reason:
        raise error(f"{target} cannot be written into: {reason.strerror or reason}") from reason
    return target


def _probe(target: Path) -> None:
    """Create an empty temporary file beside the target, and delete it. Raises OSError."""
    place = temporary_path(target)
    os.close(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    place.unlink()
