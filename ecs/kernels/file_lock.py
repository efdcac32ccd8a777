"""Locks of open files. A lock ends with its process, however that ends."""

import contextlib
import errno
import importlib
import os
from typing import Any

fcntl: Any = importlib.import_module("fcntl") if os.name == "posix" else None
msvcrt: Any = importlib.import_module("msvcrt") if os.name == "nt" else None
TAKEN = (errno.EAGAIN, errno.EACCES)  # the errors of a lock that another process holds


def try_lock(handle: int) -> bool | None:
    """Lock a file that is open for writing. Return False if another process has locked it, None without locks."""
    try:
        if msvcrt is None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        return False if error.errno in TAKEN else None
    return True


def unlock(handle: int) -> None:
    """Unlock a file. Closing it is not enough: forks of this process also have it open."""
    with contextlib.suppress(OSError):
        if msvcrt is None:
            fcntl.flock(handle, fcntl.LOCK_UN)
        else:
            msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)
