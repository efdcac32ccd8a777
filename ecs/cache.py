"""Where generated ticks are kept: source and machine code on disk, loaded functions in memory."""

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

from .fingerprint import Code
from .jit import entry
from .stored import FULL, StoredCode, keep, warn_not_kept, write
from .system import System

LOADED: dict[Any, Any] = {}  # functions by file and kernels
STAMPS: WeakKeyDictionary[Any, str] = WeakKeyDictionary()  # what kernels depended on when a tick last took them


def load(source: str, names: dict[str, Any], systems: Sequence[System], code: Code | None) -> Any:
    """Write `source` into the cache folder, run it with `names` in scope, and mark its function for compilation.

    Worlds of one structure share one function in a process: it is loaded once, however many environments come and go.
    code: what the systems compile to; None: it stays plain Python, which looks up everything anew.
    """
    name, jit = "tick_" + hashlib.sha256(source.encode()).hexdigest()[:16], code is not None
    path = cache_folder() / (code.fingerprint if code else "python") / f"{name}.py"
    key = (path, jit, *(system.kernel for system in systems))
    if key not in LOADED:
        if code:
            _forget_stale(code)
        written = _written(path, source)
        tick = _function(path, source, names)
        LOADED[key] = entry(tick) if jit else tick
        if jit and written:
            keep(LOADED[key])
    return LOADED[key]


def _forget_stale(code: Code) -> None:
    """Have numba compile those kernels again whose code, or a constant of whose, is not as when it compiled them."""
    for kernel, stamp in code.stamps():
        if getattr(kernel, "overloads", None) and STAMPS.get(kernel) != stamp:
            kernel._make_finalizer()()
            kernel._reset_overloads()
        STAMPS[kernel] = stamp


def _written(path: Path, source: str) -> bool:
    """Whether the file `path` holds the source, now at the latest. One that does is left: numba's key has its age."""
    try:
        if not path.exists() or path.read_bytes() != source.encode():
            write(path, source)
    except OSError as error:
        if error.errno not in FULL:
            raise
        warn_not_kept(error)
        return False
    return True


def _function(path: Path, source: str, names: dict[str, Any]) -> Any:
    """The function `tick` of a module whose text is `source`, which debuggers find in the file `path`."""
    module = ModuleType(f"outlast_{path.stem}")
    module.__dict__.update(names, __file__=str(path))
    sys.modules[module.__name__] = module  # where numba looks for it
    exec(compile(source, path, "exec"), module.__dict__)
    return module.tick


def is_cached(tick: Any) -> bool:
    """Whether machine code of this function is in memory or lies in the cache folder already, or none is needed."""
    if not hasattr(tick, "py_func") or tick.overloads:
        return True
    return isinstance(tick._cache, StoredCode) and tick._cache.whole()


def cache_folder() -> Path:
    """$OUTLAST_CACHE_DIR, else the user's cache folder, else (not writable) one among the temporary files.

    Raises PermissionError if the last one is not this user's alone.
    """
    if "OUTLAST_CACHE_DIR" in os.environ:
        return Path(os.environ["OUTLAST_CACHE_DIR"])
    folder = Path(platformdirs.user_cache_dir("outlast"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _temporary()
    return folder if os.access(folder, os.W_OK) else _temporary()


def _temporary() -> Path:
    """A folder among the temporary files that only this user writes to, as what lies in it is run."""
    if not hasattr(os, "getuid"):  # Windows: each user has temporary files of their own
        return Path(tempfile.gettempdir()) / "outlast"
    folder = Path(tempfile.gettempdir()) / f"outlast-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise PermissionError(f"{folder} belongs to others: name a folder for compiled code in OUTLAST_CACHE_DIR")
    return folder
