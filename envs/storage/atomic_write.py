"""Files that are complete or absent: they are written beside their target and replace it at the end.

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
import time
from collections.abc import Callable, Iterator
from pathlib import Path

LONGEST = 200  # bytes of the target's name in that of a temporary file: most file systems allow 255 in all
SHARED = (5, 32)  # errors of Windows: another process has the file open
PATIENCE = 5.0  # seconds to wait until it closes the file
TEMPORARY = re.compile(r"\.(.+)-[0-9a-f]{8}\.tmp")


def temporary_path(target: Path) -> Path:
    """Return a new path beside the target, for a temporary file that will take its place."""
    name = target.name
    if len(os.fsencode(name)) > LONGEST:
        name = os.fsencode(name)[:LONGEST].decode(errors="ignore")
    return target.with_name(f".{name}-{secrets.token_hex(4)}.tmp")


def is_temporary(path: Path) -> bool:
    """Return whether it is a temporary file: one that a process is writing, or that a killed process has left."""
    return TEMPORARY.fullmatch(path.name) is not None


def target_name(path: Path) -> str:
    """Return the name of the file that a temporary file replaces when it is complete; "" for any other file."""
    found = TEMPORARY.fullmatch(path.name)
    return found[1] if found else ""


def remove(path: Path) -> None:
    """Delete a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            _patiently(lambda: path.unlink(missing_ok=True))


def replace(path: Path, target: Path) -> None:
    """Move a file or folder to the target and replace that.

    Windows refuses this while another process has the target open, as `outlast watch` has the checkpoint that it reads.

    Raises:
        OSError: It cannot be moved; on Windows, after PATIENCE seconds.
    """
    try:
        _patiently(lambda: os.replace(path, target))
    except PermissionError as error:
        if not _is_open_elsewhere(error):
            raise
        raise PermissionError(error.errno, f"{error.strerror}; another program has it open", str(target)) from error


def _patiently(act: Callable[[], None]) -> None:
    """Act on a file; on Windows, retry for a while if another process has it open."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return act()
        except PermissionError as error:
            if not _is_open_elsewhere(error) or time.monotonic() > end:
                raise
            time.sleep(0.05)


def _is_open_elsewhere(error: PermissionError) -> bool:
    return getattr(error, "winerror", None) in SHARED


@contextlib.contextmanager
def atomic_write(target: Path, *, new: bool = False) -> Iterator[Path]:
    """Yield a path beside the target, for a file or folder that replaces the target if all goes well.

    Otherwise it is removed. If the target is a link, its target is replaced. If the target is neither a file nor
    a folder, such as a device, it is written to directly.

    Args:
        target: Where the file or folder goes.
        new: Whether the target was not there before; if another process has written it, it is not replaced.

    Raises:
        FileExistsError: Another process has written a `new` target. The new content is kept as NAME-2;
            the message has that name.
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
            _keep(path, target)
        else:
            replace(path, target)
    finally:
        remove(path)


def add(path: Path, target: Path) -> None:
    """Give a file or folder a name. Raises OSError; FileExistsError if the name is taken."""
    try:
        os.link(path, target)  # unlike renaming, this never replaces a file
    except FileExistsError:
        raise
    except OSError:  # a folder, or a file system without hard links
        if target.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from None
        replace(path, target)
    else:
        remove(path)


def _keep(path: Path, target: Path) -> None:
    """Move a file to the target, or if that exists, to the target's name with a number."""
    for number in itertools.count(1):
        place = target if number == 1 else target.with_stem(f"{target.stem}-{number}")
        try:
            add(path, place)
        except FileExistsError:
            continue
        if number > 1:
            reason = f"as another process has just written it; this is in {place}"
            raise FileExistsError(errno.EEXIST, reason, str(target))
        return
