"""Observations in the caller's memory: float32 arrays by key, or one array with a row for each agent."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .validation import Array


def flat_size(observations: Mapping[str, Array]) -> int:
    """Return the length of the row of one agent that joins all observations in order of their keys."""
    return sum(math.prod(array.shape[2:]) for array in observations.values())


def write(observations: Mapping[str, Array], arrays: Any) -> None:
    """Copy observations of shape (worlds, agents, ...) into what `checked` returned."""
    if isinstance(arrays, Mapping):
        for key, array in observations.items():
            arrays[key][...] = array
        return
    start = 0
    for array in observations.values():
        numbers = math.prod(array.shape[2:])
        arrays[:, :, start : start + numbers] = array.reshape(*array.shape[:2], numbers)
        start += numbers


def checked(observations: Mapping[str, Array], out: Any, name: str = "out") -> Any:
    """Return the caller's memory for observations.

    Args:
        observations: Observations by key, of shape (worlds, agents, ...).
        out: A mapping with a float32 array of the same shape for each key, or one float32 array
            (worlds, agents, numbers), `flat_size` numbers in order of the keys; see `writable`.
        name: What `out` is called in errors.

    Returns:
        `out` as numpy arrays that share its memory.

    Raises:
        ValueError: `out` is neither.
    """
    if not isinstance(out, Mapping):
        worlds, agents = next(iter(observations.values())).shape[:2]
        return writable(name, out, (worlds, agents, flat_size(observations)))
    if out.keys() != observations.keys():
        raise ValueError(f"{name} has the keys {sorted(out, key=repr)}: {sorted(observations)} are needed")
    return {key: writable(f"{name}[{key!r}]", out[key], array.shape) for key, array in observations.items()}


def writable(name: str, given: Any, shape: tuple[int, ...], dtype: Any = np.float32) -> Array:
    """Return the caller's memory as a numpy array.

    Args:
        name: What it is called in errors.
        given: A numpy array, or a tensor of a library that can share memory with numpy, such as PyTorch's on the CPU,
            pinned or not.
        shape: The shape that it must have.
        dtype: The type that it must have.

    Raises:
        ValueError: It has another shape or type, cannot be written to, or is on another device.
    """
    array = given
    if not isinstance(given, np.ndarray) and hasattr(given, "__dlpack__") and hasattr(given, "__array__"):
        try:
            array = given.__array__()
        except (TypeError, RuntimeError) as error:  # a tensor on a GPU, or one that requires gradients
            raise ValueError(f"{name} shares no memory with numpy: {error}") from None
    if not isinstance(array, np.ndarray) or array.dtype != dtype or array.shape != shape:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise ValueError(f"{name} is {found}: a {np.dtype(dtype)} array of shape {shape} is needed")
    if not array.flags.writeable:
        raise ValueError(f"{name} is read-only")
    steps = zip(array.strides, shape, strict=True)
    if 0 in array.strides and array.size and any(step == 0 and size > 1 for step, size in steps):
        raise ValueError(f"{name} has places that share memory, as of expand() or broadcast_to(): take a copy of it")
    return array


def read_only(array: Array) -> Array:
    """Return a view that cannot be written to: the engine writes only what changes, and relies on the rest."""
    view = array.view()
    view.flags.writeable = False
    return view
