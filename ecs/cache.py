"""Where generated ticks are kept: source and machine code on disk, loaded functions in memory."""

import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import platformdirs

from .fingerprint import fingerprint
from .jit import entry
from .module import System

LOADED: dict[Any, Any] = {}  # functions by file and kernels


def load(source: str, names: dict[str, Any], systems: Sequence[System], jit: bool) -> Any:
    """Write `source` into the cache folder, import it with `names` in scope, and mark it for compilation.

    Worlds of one structure share one function in a process: it is loaded once, however many environments come and go.
    """
    folder = cache_folder() / fingerprint(systems)
    name = "tick_" + hashlib.sha256(source.encode()).hexdigest()[:16]
    path = folder / f"{name}.py"
    if not path.exists():  # never rewritten: its age is part of numba's key
        folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=folder, suffix=".tmp")
        with os.fdopen(handle, "w") as file:
            file.write(source)
        os.replace(temporary, path)
    key = (path, jit, *(system.kernel for system in systems))
    if key not in LOADED:
        LOADED[key] = _imported(path, names, jit)
    return LOADED[key]


def _imported(path: Path, names: dict[str, Any], jit: bool) -> Any:
    """The function `tick` of the file `path`."""
    spec = importlib.util.spec_from_file_location(f"outlast_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    module.__dict__.update(names)
    sys.modules[module.__name__] = module
    spec.loader.exec_module(module)
    return entry(module.tick, cache=True) if jit else module.tick


def is_cached(tick: Any) -> bool:
    """Whether machine code of this function lies in the cache folder already, or none is needed."""
    if not hasattr(tick, "py_func"):
        return True
    path = Path(inspect.getfile(tick.py_func))
    return any((path.parent / "__pycache__").glob(f"{path.stem}.tick-*.nbi"))


def cache_folder() -> Path:
    """$OUTLAST_CACHE_DIR, else the user's cache folder, else (not writable) a folder for temporary files."""
    if "OUTLAST_CACHE_DIR" in os.environ:
        return Path(os.environ["OUTLAST_CACHE_DIR"])
    folder = Path(platformdirs.user_cache_dir("outlast"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir()) / "outlast"
    except OSError:
        return Path(tempfile.gettempdir()) / "outlast"
