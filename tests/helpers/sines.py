"""Sines and cosines of the C library, for kernels that run as Python: numpy's own differ in the last bit."""

import ctypes
import sys
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import outlast

PARTS = tuple(f"{outlast.__name__}.{part}." for part in ("components", "systems"))  # where kernels are


def _of_c(name: str) -> Callable[[Any], np.float32]:
    function = ctypes.CFUNCTYPE(ctypes.c_float, ctypes.c_float)((name, ctypes.CDLL(None)))
    return lambda x: np.float32(function(x))


@contextmanager
def sines_of_c() -> Iterator[None]:
    """A context in which systems that run as Python have the sines of compiled ones. Nothing may be compiled in it."""
    numpy: Any = types.SimpleNamespace(**vars(np) | {"cos": _of_c("cosf"), "sin": _of_c("sinf")})
    users = [module for name, module in sys.modules.items() if name.startswith(PARTS) and vars(module).get("np") is np]
    try:
        for module in users:
            vars(module)["np"] = numpy
        yield
    finally:
        for module in users:
            vars(module)["np"] = np
