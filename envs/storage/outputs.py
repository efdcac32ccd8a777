"""Places of files and folders that are going to be written: checked before any work is done for them.

All writers follow symbolic links: they replace what a link leads to, and the link stays.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from .atomic_write import temporary_path


def check_file(
    path: str | os.PathLike[str],
    what: str,
    error: type[Exception],
    *,
    endings: Sequence[str] = (),
    new: bool = False,
) -> Path:
    """Return the path of a file or folder that can be written there. Nothing is left in its place.

    Args:
        path: Where it goes.
        what: What it holds, in the plural, for messages: "events".
        error: The class of errors.
        endings: Endings of its name that are allowed; empty: all.
        new: Whether nothing may be there yet.

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
            raise error(f"{target} exists; {what} overwrite nothing: give another name, or delete it")
        if target.is_dir():
            raise error(f"{target} cannot be written: it is a folder")
        real = Path(os.path.realpath(target))
        if not real.parent.is_dir():
            folder = real.parent if target.is_symlink() else target.parent
            raise error(f"{target} cannot be written: there is no folder {folder}")
        if not there or target.is_file():  # a device is written to as it is
            _probe(real)
    except OSError as reason:
        raise error(f"{target} cannot be written: {reason.strerror or reason}") from reason
    return target


def check_folder(path: str | os.PathLike[str], error: type[Exception]) -> Path:
    """Return the path of a folder, if files can be written into it, or if it can be made with all around it.

    Raises:
        error: It is a file, or nothing can be written there.
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
    """Make an empty temporary file beside the target, and delete it. Raises OSError."""
    place = temporary_path(target)
    os.close(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    place.unlink()
