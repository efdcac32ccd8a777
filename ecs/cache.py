"""The compile cache: generated ticks as source and machine code on disk, and as loaded functions in memory.

The folder of a tick is named by its key (cache_key); cache_files verifies the machine code in it.
"""

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import platformdirs

from .cache_files import DISK_FULL, ChecksummedCache, atomic_write, enable_disk_cache, warn_not_cached
from .cache_key import CacheKey
from .jit import entry_point
from .system import System

LOADED: dict[Any, Any] = {}  # functions by file and kernels
DIGESTS: WeakKeyDictionary[Any, str] = WeakKeyDictionary()  # of kernels, when a tick last used them


def load(source: str, names: dict[str, Any], systems: Sequence[System], cache_key: CacheKey | None) -> Any:
    """Write `source` into the cache folder, run it with `names` in scope, and mark its function for compilation.

    Worlds of one structure share one function in a process, however many environments are made and closed.
    cache_key: of `systems`; None for a tick that stays plain Python, which looks up everything when it runs.
    """
    name = "tick_" + hashlib.sha256(source.encode()).hexdigest()[:16]
    path = cache_folder() / (cache_key.digest if cache_key else "python") / f"{name}.py"
    loaded = (path, cache_key is not None, *(system.kernel for system in systems))
    if loaded not in LOADED:
        if cache_key:
            _discard_outdated(cache_key)
        written = _ensure_written(path, source)
        tick = _execute(path, source, names)
        LOADED[loaded] = entry_point(tick) if cache_key else tick
        if cache_key and written:
            enable_disk_cache(LOADED[loaded])
    return LOADED[loaded]


def _discard_outdated(cache_key: CacheKey) -> None:
    """Discard machine code of kernels that have changed, or refer to what has, since numba compiled them."""
    for kernel, digest in cache_key.kernel_digests():
        if getattr(kernel, "overloads", None) and DIGESTS.get(kernel) != digest:
            kernel._make_finalizer()()
            kernel._reset_overloads()
        DIGESTS[kernel] = digest


def _ensure_written(path: Path, source: str) -> bool:
    """Write `source` unless the file has it already (numba's key has the file's age); False if the disk is full."""
    try:
        if not path.exists() or path.read_bytes() != source.encode():
            atomic_write(path, source)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        warn_not_cached(error)
        return False
    return True


def _execute(path: Path, source: str, names: dict[str, Any]) -> Any:
    """Run `source` as a module, which debuggers find in the file `path`; returns its function `tick`."""
    module = ModuleType(f"outlast_{path.stem}")
    module.__dict__.update(names, __file__=str(path))
    sys.modules[module.__name__] = module  # where numba looks for it
    exec(compile(source, path, "exec"), module.__dict__)
    return module.tick


def is_cached(tick: Any) -> bool:
    """Whether this function is compiled, has machine code in the cache folder, or needs none."""
    if not hasattr(tick, "py_func") or tick.overloads:
        return True
    return isinstance(tick._cache, ChecksummedCache) and tick._cache.is_valid()


def cache_folder() -> Path:
    """$OUTLAST_CACHE_DIR, else the user's cache folder, else (if that is not writable) a temporary folder.

    Raises:
        PermissionError: Another user owns the temporary folder, or may write to it.
    """
    if "OUTLAST_CACHE_DIR" in os.environ:
        return Path(os.environ["OUTLAST_CACHE_DIR"])
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
