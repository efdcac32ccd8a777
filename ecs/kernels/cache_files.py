"""The compile cache's files: one for each unit of machine code, verified by a checksum before it is loaded.

A file counts as absent, and is written again, if it does not match its checksum (after a full disk, or a process that
was killed), if it is not a regular file, or if others than the user and root could have written it.
"""

import contextlib
import hashlib
import json
import os
import re
import secrets
import stat
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

from .cache_folder import cache_folder, is_private
from .file_lock import try_lock, unlock
from .machine_code import Code

DAY = 86_400  # seconds
LARGEST = 256 * 2**20  # bytes of all files together; beyond that, those unused for longest are deleted
SUFFIX, CLAIM = ".unit", ".claim"
TEMPORARY = re.compile(r"tmp\w{8}\.tmp")
LONGEST = 80  # characters of a label in the name of its file
PATIENCE = 60.0  # seconds to wait for another process: most units take less than one, the largest a few
PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # neither follows a link nor waits for a FIFO
WARNED: list[str] = []  # the warning of this process
DESCRIPTION = ("symbol", "constants", "externals")  # attributes of a Code that the first line of its file has


def file_name(label: str, key: str) -> str:
    """Return the name of a unit's file, which all file systems allow."""
    return f"{re.sub(r'[^A-Za-z0-9_.]', '_', label)[:LONGEST]}-{key}{SUFFIX}"


def read(path: Path) -> Code | None:
    """Return the machine code in a file; None if the file counts as absent."""
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | PLAIN)) as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode) or not is_private(found) or found.st_size > LARGEST:
                return None
            head, _, image = file.read().partition(b"\n")
    except OSError:
        return None
    try:
        header = json.loads(head)
        code = Code(header["symbol"], image, header["constants"], header["externals"])
        if header["checksum"] != _checksum(code):
            return None
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    if time.time() - found.st_mtime > DAY:
        with contextlib.suppress(OSError):  # the folder may be read-only
            os.utime(path)  # keeps it from being deleted as unused
    return code


def write(path: Path | None, code: Code) -> bool:
    """Write a file, whole or not at all.

    Args:
        path: The file; if there is none, nothing is written.
        code: Its content.

    Returns:
        Whether other processes can load it: not if the code cannot be loaded elsewhere or, with a warning, if it
        cannot be written.
    """
    if path is None or not code.portable:
        return False
    try:
        head = json.dumps({"checksum": _checksum(code), **{name: getattr(code, name) for name in DESCRIPTION}})
    except TypeError:  # a constant that JSON cannot hold: each process compiles the unit again
        return False
    temporary = path.with_name(f"tmp{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        # Never writable for a group, in spite of the umask: such files count as absent
        with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, 0o644)) as file:
            file.write(head.encode() + b"\n" + code.image)
        os.replace(temporary, path)
    except OSError as error:
        if read(path):  # Windows does not replace a file that another process has open; its content is the same
            return True
        warn(f"compiled code is not kept for later processes: {error}")
        return False
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return True


def warn(text: str) -> None:
    """Warn that compiled code is kept elsewhere or nowhere, once in a process."""
    if not WARNED:
        WARNED.append(text)
        warnings.warn(text, RuntimeWarning, stacklevel=3)


@contextlib.contextmanager
def claimed(path: Path | None, wait: bool) -> Iterator[bool]:
    """Claim a unit, so that processes that begin together compile different ones, and none twice.

    A claim ends with its process, however that ends. Where files cannot be locked, every process can claim everything.

    Args:
        path: The unit's file; without one, no other process would find it, so it can be claimed.
        wait: Whether to wait for a process that has claimed it, but no longer than PATIENCE: it may be suspended.

    Yields:
        Whether to compile the unit here, unless the file is there by now.
    """
    if path is None:
        yield True
        return
    claim, mine, end = path.with_suffix(CLAIM), False, time.monotonic() + PATIENCE * wait
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        handle = os.open(claim, os.O_CREAT | os.O_RDWR | PLAIN, 0o600)
    except OSError:  # what is compiled cannot be kept either, which `write` reports
        yield True
        return
    try:
        while not (mine := try_lock(handle) is not False) and time.monotonic() < end:
            time.sleep(0.01)
        yield mine or wait
    finally:
        if mine:
            with contextlib.suppress(OSError):  # Windows deletes no open file: `prune` does
                claim.unlink()
            unlock(handle)
        os.close(handle)


def prune() -> None:
    """Delete what killed processes left, and if all units together are too large, those that are unused for longest."""
    now, size, folder = time.time(), 0, cache_folder()
    with contextlib.suppress(OSError):
        for used, bytes_, path in sorted(_found(folder) if folder else (), reverse=True):
            size += bytes_
            if size > LARGEST or (path.suffix != SUFFIX and now - used > DAY):
                with contextlib.suppress(OSError):
                    path.unlink()


def _found(folder: Path) -> Iterator[tuple[float, int, Path]]:
    """Yield time of the last use, size and path of each of the cache's files."""
    for path in folder.iterdir():
        found = path.lstat()
        own = path.suffix in (SUFFIX, CLAIM) or TEMPORARY.fullmatch(path.name)
        if own and stat.S_ISREG(found.st_mode):
            yield found.st_mtime, found.st_size, path


def _checksum(code: Code) -> str:
    told = json.dumps([getattr(code, name) for name in DESCRIPTION]).encode()
    return hashlib.sha256(told + code.image).hexdigest()
