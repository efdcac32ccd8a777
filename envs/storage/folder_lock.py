"""Folders that one process at a time writes into."""

import contextlib
import fnmatch
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path

from outlast.ecs.kernels.file_lock import try_lock, unlock

from .outputs import remove, target_name

LOCK, OWNER = ".lock", ".owner"  # names of files: the locked one; without locks, the one that names a process
OLD = 86_400.0  # seconds after which a temporary file is no longer being written


class FolderLock:
    """A lock that keeps other processes out of a folder until `release`, or until this process ends for any reason.

    It locks a file in the folder, which it opens for writing, as NFS requires. On file systems without locks, a
    file that names the process keeps others out; if the process is killed, the file stays; it is then ignored on the
    same machine, and must be deleted on others.

    does: what its holder does, for messages. writes: patterns of the names of files that only its holder writes.
    """

    def __init__(self, folder: Path, does: str = "writes into it", writes: Sequence[str] = ()) -> None:
        self.folder, self.does, self.writes = folder, does, writes
        self._handle, self._file, self._owner = -1, folder / LOCK, 0

    def acquire(self) -> None:
        """Create the folder if it is missing, lock it, and remove temporary files of killed processes.

        Files that another process may be writing are kept: those that `writes` does not match, and without locks all of
        them, unless they are old.

        Raises:
            BlockingIOError: Another process, or another FolderLock of this process, has locked it.
            OSError: It cannot be created, or is not writable.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self._lock():
            self._own()
        self._owner = os.getpid()
        for path in filter(target_name, list(self.folder.iterdir())):
            own = any(fnmatch.fnmatchcase(target_name(path), pattern) for pattern in self.writes)
            if (own and self._handle >= 0) or time.time() - _written(path) > OLD:
                remove(path)

    def _lock(self) -> bool:
        """Lock the file, and return whether files can be locked here. Raises BlockingIOError."""
        self._file = self.folder / LOCK
        while True:
            handle = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o666)
            locked = try_lock(handle)
            with contextlib.suppress(FileNotFoundError):  # the previous holder may have just deleted the file
                if locked and os.path.samestat(self._file.stat(), os.fstat(handle)):
                    self._handle = handle
                    return True
            os.close(handle)
            if locked is None:
                self._file.unlink(missing_ok=True)
                return False
            if not locked:
                raise self._taken("")

    def _own(self) -> None:
        """Create the file that names this process. Raises BlockingIOError."""
        self._file = self.folder / OWNER
        host, other = platform.node(), ""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            other = self._file.read_text(encoding="utf-8")
        if other.startswith(f"{host} ") and not _is_alive(other.removeprefix(f"{host} ")):
            self._file.unlink(missing_ok=True)
        try:
            handle = os.open(self._file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            cure = f"; files cannot be locked here, so if process {other} was killed, delete {self._file}"
            raise self._taken(cure) from None
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(f"{host} {os.getpid()}")

    def _taken(self, cure: str) -> BlockingIOError:
        ways = "wait until it ends, stop it, or choose another --out"
        return BlockingIOError(f"{self.folder}: another process {self.does}; {ways}{cure}")

    def release(self) -> None:
        """Unlock the folder; may be called repeatedly."""
        handle, owner, self._handle, self._owner = self._handle, self._owner, -1, 0
        if owner == os.getpid():  # not in a fork, which has the same file open
            if os.name != "nt":  # Windows does not delete open files
                with contextlib.suppress(OSError):  # before unlocking it: afterwards another process may lock it
                    self._file.unlink()
            if handle >= 0:
                unlock(handle)
        if handle >= 0:
            os.close(handle)

    __del__ = release


def is_lock(path: Path) -> bool:
    """Return whether it is a file of a FolderLock, also one that was deleted while a process of NFS had it open."""
    return path.name in (LOCK, OWNER) or path.name.startswith(".nfs")


def _is_alive(pid: str) -> bool:
    """Return whether a process of this machine may have that number."""
    if not pid.isdecimal() or os.name != "posix":  # os.kill would end it on Windows
        return True
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _written(path: Path) -> float:
    """Return the time of the last change of a file, or of the files of a folder; now, if it is gone."""
    try:
        return float(max(each.stat().st_mtime for each in (path, *(path.iterdir() if path.is_dir() else ()))))
    except OSError:
        return time.time()
