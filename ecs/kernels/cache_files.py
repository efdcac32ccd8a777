"""The compile cache's files: one for each unit of machine code, verified by a checksum before it is loaded.

A file counts as absent, and is written again, if it does not match its checksum (after a full disk, or a killed
process), if it is not a regular file, or if users other than this one and root could have written it.

Write access to a folder of machine code lets others run code as its reader. A folder is therefore used directly only if
it is writable for the user and root alone. Below shared folders, of a group or temporary, the user has a private one.
"""

import contextlib
import hashlib
import json
import os
import re
import secrets
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import platformdirs

from .file_lock import try_lock, unlock
from .machine_code import Code

DAY = 86_400  # seconds
LARGEST = 256 * 2**20  # bytes of all files together; beyond that, the least recently used are deleted
SUFFIX, LOCK = ".unit", ".lock"
OWN = re.compile(r"\.unit$|^tmp\w{8}\.tmp$")
LONGEST = 80  # characters of a label in the name of its file
PATIENCE = 300.0  # seconds to wait for another compiling process
PLAIN = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # neither follows a link nor waits for a FIFO
WARNED: list[str] = []  # the warnings of this process
DESCRIPTION = ("symbol", "constants", "externals")  # attributes of a Code that are ahead of the object file
try:
    START = Path.cwd()  # keeps relative folders when the program changes its working directory
except OSError:  # it has been deleted
    START = Path()
POSIX = os.name == "posix"  # on Windows, users' folders for data and temporary files are private


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
            checksum, _, content = file.read().partition(b"\n")
    except OSError:
        return None
    if checksum != _checksum(content):
        return None
    head, _, image = content.partition(b"\n")
    if time.time() - found.st_mtime > DAY:
        with contextlib.suppress(OSError):  # the folder may be read-only
            os.utime(path)  # so that it is not deleted as unused
    return Code(image=image, **json.loads(head))


def write(path: Path | None, code: Code) -> bool:
    """Write a file, completely or not at all; without a path, write nothing.

    Returns:
        Whether other processes can load it: not if the code cannot be loaded elsewhere or, with a warning, if writing
        failed.
    """
    if path is None or not code.portable:
        return False
    try:
        head = json.dumps({name: getattr(code, name) for name in DESCRIPTION})
    except TypeError:  # a constant that JSON cannot hold: each process compiles the unit again
        return False
    content = head.encode() + b"\n" + code.image
    temporary = path.with_name(f"tmp{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        # Never writable for a group, regardless of the umask: such files count as absent
        with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, 0o644)) as file:
            file.write(_checksum(content) + b"\n" + content)
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
def one_at_a_time() -> Iterator[None]:
    """Let one process at a time compile, so that processes started together find the files of the first one.

    The lock ends with its process, however that ends. Others wait at most PATIENCE seconds, since that process may
    be suspended, and do not wait where files cannot be locked.
    """
    handle, folder, end = -1, cache_folder(), time.monotonic() + PATIENCE
    with contextlib.suppress(OSError):
        handle = os.open(folder / LOCK, os.O_CREAT | os.O_RDWR | PLAIN, 0o600) if folder else -1
    try:
        while handle >= 0 and try_lock(handle) is False and time.monotonic() < end:
            time.sleep(0.01)
        yield
    finally:
        if handle >= 0:
            unlock(handle)
            os.close(handle)


def prune() -> None:
    """Delete files of killed processes, and if all units together are too large, the least recently used ones."""
    now, size, folder = time.time(), 0, cache_folder()
    with contextlib.suppress(OSError):
        own = [each for each in folder.iterdir() if OWN.search(each.name)] if folder else []
        found = [(path.lstat(), path) for path in own]
        for about, path in sorted(found, key=lambda each: -each[0].st_mtime):
            if stat.S_ISREG(about.st_mode):
                size += about.st_size
                if size > LARGEST or (path.suffix != SUFFIX and now - about.st_mtime > DAY):
                    with contextlib.suppress(OSError):
                        path.unlink()


def _checksum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


class CacheFolders(NamedTuple):
    """Folders of machine code."""

    readable: list[Path]  # folders from which code is loaded, by preference
    writable: Path | None  # folder of new code
    problem: str  # reason why it is not the first choice


def cache_folders() -> CacheFolders:
    """Return $OUTLAST_CACHE_DIR, or the user's cache folder; and if that is not writable, also a temporary one."""
    readable, problems = list[Path](), list[str]()
    for find in (_first_choice, lambda: _own_folder(Path(tempfile.gettempdir()))):
        try:
            readable.append(folder := find())
        except OSError as error:
            problems.append(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        except RuntimeError as error:  # the user has no home folder
            problems.append(str(error))
        else:
            if os.access(folder, os.W_OK | os.X_OK):
                return CacheFolders(readable, folder, "; ".join(problems))
            problems.append(f"{folder} is not writable")
    return CacheFolders(readable, None, "; ".join(problems))


def cache_folder() -> Path | None:
    """Return the folder of new machine code; None if no folder is writable."""
    return cache_folders().writable


def is_private(found: os.stat_result) -> bool:
    """Return whether only this user and root can have written a file, or can write to a folder."""
    return not POSIX or (found.st_uid in (0, os.geteuid()) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def _first_choice() -> Path:
    folder = START / Path(os.environ.get("OUTLAST_CACHE_DIR") or platformdirs.user_cache_dir("outlast")).expanduser()
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    return folder if is_private(folder.stat()) else _own_folder(folder)


def _own_folder(parent: Path) -> Path:
    """Return the user's private folder in one that others can write to. Raises OSError."""
    folder = parent / (f"outlast-{os.geteuid()}" if POSIX else "outlast")
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()  # a link could lead to a folder of other programs, whose old files would be deleted
    if not stat.S_ISDIR(found.st_mode) or not is_private(found):
        raise PermissionError(f"others can write to {folder}")
    return folder
