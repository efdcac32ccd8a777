"""OpenCV, imported by the first use of it: loading it takes longer than everything else, and most runs draw nothing."""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what the import system asks of every module
        raise AttributeError(name)
    return globals().setdefault(name, getattr(import_module("cv2"), name))
