"""Folders that one process at a time writes into."""

import os
from pathlib import Path

from outlast.ecs.cache_files import fcntl, try_lock, unlock


class FolderLock:
    """Keeps other processes out of a folder until `release`, or until this process ends, however it does.

    Where folders cannot be locked, as on Windows, all processes may write into them.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._handle: int | None = None

    def acquire(self) -> None:
        """Lock the folder, which must exist.

        Raises:
            BlockingIOError: Another process, or another FolderLock of this process, has locked it.
        """
        if fcntl is None:
            return
        handle = os.open(self.folder, os.O_RDONLY)
        if not try_lock(handle):
            os.close(handle)
            raise BlockingIOError(f"{self.folder} is in use")
        self._handle = handle

    def release(self) -> None:
        """Unlock the folder; calling this again does no harm."""
        handle, self._handle = self._handle, None
        if handle is not None:
            unlock(handle)
            os.close(handle)

    __del__ = release
