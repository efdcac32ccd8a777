"""The folders of the compile cache.

Whoever can write to a folder of machine code can run code as its reader. So a folder is used as it is only if nobody
but the user and root can write to it. Below others, as a group's or the temporary one, the user has a private folder.
"""

import os
import stat
import tempfile
from pathlib import Path
from typing import NamedTuple

import platformdirs

try:
    START = Path.cwd()  # a relative folder does not move when the program changes its working directory
except OSError:  # it has been deleted
    START = Path()
POSIX = os.name == "posix"  # on Windows, users have folders for their data and for temporary files that are private


class CacheFolders(NamedTuple):
    """Folders of machine code.

    Attributes:
        readable: Those that code is loaded from, the first choice first.
        writable: The one that new code is written to; None if there is none.
        problem: Why that is not the first choice; "" if it is.
    """

    readable: list[Path]
    writable: Path | None
    problem: str


def cache_folders() -> CacheFolders:
    """Return $OUTLAST_CACHE_DIR, else the user's cache folder; and if that is not writable, a temporary one, too."""
    readable, problems = list[Path](), list[str]()
    for find in (_first_choice, _temporary):
        try:
            readable.append(folder := find())
        except OSError as error:
            problems.append(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        except RuntimeError as error:  # there is no home
            problems.append(str(error))
        else:
            if os.access(folder, os.W_OK | os.X_OK):
                return CacheFolders(readable, folder, "; ".join(problems))
            problems.append(f"{folder} is not writable")
    return CacheFolders(readable, None, "; ".join(problems))


def cache_folder() -> Path | None:
    """Return the folder that new machine code is written to; None if there is none."""
    return cache_folders().writable


def is_private(found: os.stat_result) -> bool:
    """Return whether only this user and root can have written a file, or can write to a folder."""
    return not POSIX or (found.st_uid in (0, os.geteuid()) and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def _first_choice() -> Path:
    folder = START / Path(os.environ.get("OUTLAST_CACHE_DIR") or platformdirs.user_cache_dir("outlast")).expanduser()
    folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    return folder if is_private(folder.stat()) else _own_folder(folder)


def _temporary() -> Path:
    return _own_folder(Path(tempfile.gettempdir()))


def _own_folder(parent: Path) -> Path:
    """Return a private folder of the user's in one that others can write to. Raises OSError."""
    folder = parent / (f"outlast-{os.geteuid()}" if POSIX else "outlast")
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()  # a link could lead to a folder where files of other programs would be deleted as old
    if not stat.S_ISDIR(found.st_mode) or not is_private(found):
        raise PermissionError(f"others can write to {folder}")
    return folder
