"""What machine code depends on, as one number: the name of the folder in which a tick's code is kept.

numba's own key knows the generated file of the tick only; not the files of the kernels it calls, nor the bodies of
functions that have no file (a notebook's, a closure's), nor its own flags.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np

from .module import System

FOREIGN = ("numba", "numpy", "math", "builtins")  # their versions stand for them


def fingerprint(systems: Iterable[System]) -> str:
    """Hash of the engine's and the game's sources, all that `systems` call or refer to, versions, NUMBA_* variables."""
    package = Path(__file__).parent.parent
    digest = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for key in sorted(key for key in os.environ if key.startswith("NUMBA_")):
        digest.update(f"{key}={os.environ[key]}".encode())
    for path in sorted(
        path for folder in ("ecs", "components", "systems") for path in (package / folder).rglob("*.py")
    ):
        digest.update(path.name.encode() + path.read_bytes())
    seen: set[FunctionType] = set()
    for system in systems:
        for text in _described(system.function, seen):
            digest.update(text.encode())
    return digest.hexdigest()[:16]


def _described(thing: Any, seen: set[FunctionType]) -> Iterator[str]:
    """A constant by its value; a function by its code and, in turn, all that it refers to."""
    function = getattr(thing, "py_func", thing)
    if isinstance(function, np.ndarray):
        yield f"{function.dtype}{function.shape}{function.tobytes().hex()}"
    elif isinstance(function, (bool, int, float, str, bytes, tuple, np.generic)):
        yield repr(function)
    elif isinstance(function, FunctionType) and function not in seen and not _foreign(function):
        seen.add(function)
        yield from _code(function.__code__)
        for value in _referred(function):
            yield from _described(value, seen)


def _code(code: CodeType) -> Iterator[str]:
    yield f"{code.co_qualname}{code.co_names}{code.co_code.hex()}"
    for constant in code.co_consts:
        yield from _code(constant) if isinstance(constant, CodeType) else (repr(constant),)


def _referred(function: FunctionType) -> list[Any]:
    """What the names in a function's code stand for: globals, members of modules, and a closure's cells."""
    names = function.__code__.co_names
    values = [function.__globals__[name] for name in names if name in function.__globals__]
    modules = [value for value in values if isinstance(value, ModuleType) and not _foreign(value)]
    members = [getattr(module, name) for module in modules for name in names if hasattr(module, name)]
    return [*values, *members, *(cell.cell_contents for cell in function.__closure__ or ())]


def _foreign(thing: Any) -> bool:
    return str(getattr(thing, "__module__", None) or thing.__name__).split(".")[0] in FOREIGN
