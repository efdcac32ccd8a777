"""The compile cache's files: one for each unit of machine code, verified by a checksum before it is loaded.

A file that does not match its checksum (after a full disk, or a process that was killed) counts as absent, and is
written again. This protects against accidents, not attacks: whoever can write to the folder can run code.
"""

import contextlib
import errno
import hashlib
import importlib
import json
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import platformdirs

from .machine_code import Code

fcntl: Any = importlib.import_module("fcntl") if os.name == "posix" else None  # Windows has none
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # other errors of the disk are raised
DAY = 86_400  # seconds
UNUSED = 30 * DAY  # files that nobody has loaded for this long are deleted
LARGEST = 256 * 2**20  # bytes of all files together; beyond that, those unused for longest are deleted
SUFFIX, CLAIM = ".unit", ".claim"
PATIENCE = 60.0  # seconds to wait for another process: most units take less than one, the largest a few
DESCRIPTION = ("symbol", "constants", "externals")  # attributes of a Code that the first line of its file has


def path_of(label: str, key: str) -> Path:
    """The file of a unit."""
    return cache_folder() / f"{label}-{key}{SUFFIX}"


def read(path: Path) -> Code | None:
    """The machine code in a file; None if there is none, or it is damaged."""
    try:
        content = path.read_bytes()
        if time.time() - path.stat().st_mtime > DAY:
            os.utime(path)  # tells `prune` that it is in use
    except OSError:
        return None
    head, _, image = content.partition(b"\n")
    try:
        header = json.loads(head)
        code = Code(header["symbol"], image, header["constants"], header["externals"])
        return code if header["checksum"] == _checksum(code) else None
    except (ValueError, TypeError, KeyError):
        return None


def write(path: Path, code: Code) -> bool:
    """Write a file, whole or not at all. False if others could not load it or, with a warning, if the disk is full."""
    if not code.portable:
        return False
    try:
        head = json.dumps({"checksum": _checksum(code), **{name: getattr(code, name) for name in DESCRIPTION}})
    except TypeError:  # a constant that JSON cannot hold: each process compiles the unit again
        return False
    try:
        _atomic_write(path, head.encode() + b"\n" + code.image)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        warnings.warn(f"compiled code is not kept for later processes: {error}", RuntimeWarning, stacklevel=3)
        return False
    return True


@contextlib.contextmanager
def claimed(path: Path, wait: bool) -> Iterator[bool]:
    """Claim a unit, so that processes that begin together compile different ones, and none twice.

    A claim ends with its process, however that ends. Where files cannot be locked, every process can claim everything.

    Args:
        path: The unit's file.
        wait: Whether to wait for a process that has claimed it, but no longer than PATIENCE: it may be suspended.

    Yields:
        Whether to compile the unit here, unless the file is there by now.
    """
    if fcntl is None:
        yield True
        return
    claim, mine, end = path.with_suffix(CLAIM), False, time.monotonic() + PATIENCE * wait
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(claim, os.O_CREAT | os.O_RDWR, 0o600)
    except OSError:  # what is compiled cannot be kept either, which `write` reports
        yield True
        return
    try:
        while not (mine := try_lock(handle)) and time.monotonic() < end:
            time.sleep(0.01)
        yield mine or wait
    finally:
        if mine:
            with contextlib.suppress(OSError):
                claim.unlink()
            unlock(handle)
        os.close(handle)


def try_lock(handle: int) -> bool:
    """Lock a file, or do nothing if files cannot be locked. False if another process has locked it."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


def unlock(handle: int) -> None:
    """Let other processes lock a file. Closing it is not enough: forks of this process have it open, too."""
    with contextlib.suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_UN)


def prune() -> None:
    """Delete files that were not used for long, then those unused for longest, until the rest is small enough."""
    now, size = time.time(), 0
    with contextlib.suppress(OSError):
        for used, bytes_, path in sorted(_found(cache_folder()), reverse=True):
            size += bytes_
            if now - used > UNUSED or size > LARGEST:
                with contextlib.suppress(OSError):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _found(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """Time of the last use, size and path of each file, and of each folder in which outlast 0.1 kept a tick."""
    for path in folder.iterdir():
        found = path.lstat()
        if path.suffix in (SUFFIX, CLAIM) and stat.S_ISREG(found.st_mode):
            yield found.st_mtime, found.st_size, path
        elif stat.S_ISDIR(found.st_mode) and any(path.glob("tick_*.py")):
            yield found.st_mtime, 0, path


def _checksum(code: Code) -> str:
    told = json.dumps([getattr(code, name) for name in DESCRIPTION]).encode()
    return hashlib.sha256(told + code.image).hexdigest()


def _atomic_write(path: Path, content: bytes) -> None:
    """Write a whole file or none, and make its folder. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def cache_folder() -> Path:
    """$OUTLAST_CACHE_DIR, else the user's cache folder, else (if that is not writable) a temporary folder.

    Raises:
        OSError: $OUTLAST_CACHE_DIR cannot be made; or, as PermissionError, another user owns the temporary folder, or
            may write to it.
    """
    if given := os.environ.get("OUTLAST_CACHE_DIR"):
        try:
            Path(given).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise type(error)(
                f"OUTLAST_CACHE_DIR={given} cannot be a folder: {error.strerror}; name another"
            ) from error
        return Path(given)
    folder = Path(platformdirs.user_cache_dir("outlast"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _temporary_folder()
    return folder if os.access(folder, os.W_OK) else _temporary_folder()


def _temporary_folder() -> Path:
    """A temporary folder that only this user may write to, as the code in it is executed."""
    if not hasattr(os, "getuid"):  # Windows: each user has a temporary folder of their own
        return Path(tempfile.gettempdir()) / "outlast"
    folder = Path(tempfile.gettempdir()) / f"outlast-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise PermissionError(f"{folder} belongs to others: name a folder for compiled code in OUTLAST_CACHE_DIR")
    return folder
