"""Observations written into memory of the caller: float32 arrays by key, or one array with a row for each agent."""

from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def flat_size(observations: Mapping[str, Array]) -> int:
    """Numbers in the row of one agent, all observations one behind the other in order of their keys."""
    return sum(int(np.prod(array.shape[2:])) for array in observations.values())


def write(observations: Mapping[str, Array], out: Any) -> None:
    """Copy observations of shape (worlds, agents, ...) into `out`.

    out: a mapping with a float32 array of the same shape for each key, or one float32 array (worlds, agents, numbers),
    `flat_size` numbers in order of the keys. Raises ValueError, before anything is written, if it is neither.
    """
    if isinstance(out, Mapping):
        _check_mapping(observations, out)
        for key, array in observations.items():
            out[key][...] = array
        return
    worlds, agents = next(iter(observations.values())).shape[:2]
    shape = (worlds, agents, flat_size(observations))
    _check("out", out, shape)
    start = 0
    for array in observations.values():
        numbers = int(np.prod(array.shape[2:]))
        out[:, :, start : start + numbers] = array.reshape(worlds, agents, numbers)
        start += numbers


def final_observations(observations: Mapping[str, Array], where: Array) -> Array:
    """A copy of the observations of each of the worlds `where`, None for the others; objects (worlds,)."""
    found = np.full(len(where), None, object)
    for w in np.flatnonzero(where):
        found[w] = {key: array[w].copy() for key, array in observations.items()}
    return found


def _check_mapping(observations: Mapping[str, Array], out: Mapping[str, Any]) -> None:
    if out.keys() != observations.keys():
        raise ValueError(f"out has the keys {sorted(out)}: {sorted(observations)} are needed")
    for key, array in observations.items():
        _check(f"out[{key!r}]", out[key], array.shape)


def _check(name: str, array: Any, shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != np.float32 or array.shape != shape:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise ValueError(f"{name} is {found}: a float32 array of shape {shape} is needed")
    if not array.flags.writeable:
        raise ValueError(f"{name} is read-only")


def read_only(array: Array) -> Array:
    """A view that cannot be written to: the engine writes only what changes, and relies on the rest."""
    view = array.view()
    view.flags.writeable = False
    return view
