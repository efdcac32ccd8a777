"""OpenCV, imported on first use: loading it takes longer than everything else, and most runs draw nothing."""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # the import system asks every module for such names
        raise AttributeError(name)
    return globals().setdefault(name, getattr(import_module("cv2"), name))
