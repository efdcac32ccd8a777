"""Files that are whole or not there: written beside their target, which they replace when they are done.

A process that is killed leaves its temporary file, `.NAME-XXXXXXXX.tmp` with eight hexadecimal digits: nothing reads
it, and it can be deleted.
"""

import contextlib
import errno
import itertools
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

TEMPORARY = re.compile(r"\..+-[0-9a-f]{8}\.tmp")


def temporary_path(target: Path) -> Path:
    """A new path beside the target, for a temporary file that takes its place."""
    return target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")


def is_temporary(path: Path) -> bool:
    """Whether it is a temporary file: one that another process is writing, or that a killed one left."""
    return TEMPORARY.fullmatch(path.name) is not None


def remove(path: Path) -> None:
    """Delete a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_write(target: Path, *, new: bool = False) -> Iterator[Path]:
    """A path beside the target, for a file or a folder that takes its place if all goes well, and else vanishes.

    Of a link, what it leads to is replaced. What is neither a file nor a folder, such as a device, is written to.

    Args:
        target: Where it goes.
        new: Whether the file, which was not there, must not replace one that another process has written meanwhile.

    Raises:
        FileExistsError: One has, for something `new`; what was written is kept as NAME-2, which the error says.
    """
    if target.exists() and not target.is_file() and not target.is_dir():
        yield target
        return
    given, target = target, Path(os.path.realpath(target))
    if not target.parent.is_dir():
        parent = target.parent if given.is_symlink() else given.parent
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(parent))
    path = temporary_path(target)
    try:
        yield path
        if target.is_dir() and not path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(given))
        if new:
            _add(path, target)
        else:
            os.replace(path, target)
    finally:
        remove(path)


def _add(path: Path, target: Path) -> None:
    """Give a file the name of the target, or if there is one of that name, one with a number."""
    for number in itertools.count(1):
        place = target if number == 1 else target.with_stem(f"{target.stem}-{number}")
        try:
            os.link(path, place)  # which replaces nothing, as renaming does
        except FileExistsError:
            continue
        except OSError:  # a folder, or a disk without links
            if place.exists():
                continue
            os.replace(path, place)
        if number > 1:
            reason = f"as another process has written it meanwhile; this is in {place}"
            raise FileExistsError(errno.EEXIST, reason, str(target))
        return
