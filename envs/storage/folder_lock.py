"""Folders that one process at a time writes into."""

import os
from pathlib import Path

from outlast.ecs.cache_files import fcntl, try_lock, unlock

from .atomic_write import is_temporary, remove


class FolderLock:
    """Keeps other processes out of a folder until `release`, or until this process ends, however it does.

    Where folders cannot be locked, as on Windows, all processes may write into them. does: what whoever has locked the
    folder does, for the message of `acquire`.
    """

    def __init__(self, folder: Path, does: str = "writes into it") -> None:
        self.folder, self.does = folder, does
        self._handle: int | None = None

    def acquire(self) -> None:
        """Make the folder, unless it exists, lock it, and remove temporary files of a killed process.

        Raises:
            BlockingIOError: Another process, or another FolderLock of this process, has locked it.
            OSError: It cannot be made.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if fcntl is not None:
            self._lock()
        for path in filter(is_temporary, list(self.folder.iterdir())):
            remove(path)

    def _lock(self) -> None:
        handle = os.open(self.folder, os.O_RDONLY)
        if not try_lock(handle):
            os.close(handle)
            cure = "wait until it ends, stop it, or choose another --out"
            raise BlockingIOError(f"{self.folder}: another process {self.does}; {cure}")
        self._handle = handle

    def release(self) -> None:
        """Unlock the folder; calling this again does no harm."""
        handle, self._handle = self._handle, None
        if handle is not None:
            unlock(handle)
            os.close(handle)

    __del__ = release
