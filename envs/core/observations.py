"""Observations in the form for a learner: by key, flat or as lists, in units or scaled."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from outlast.ecs import Observation, Worlds
from outlast.ecs.declarations.fields import Field, column_names

from .scaling import Scale, joined
from .spaces import bounds, published
from .validation import Array, check_choice
from .visible_rows import VisibleRows

KINDS = ("dict", "flat", "rows")
Arrays = dict[str, Array]


class Observations:
    """A reader of observations.

    "dict": float32 arrays (worlds, agents, ...) by key. "flat": one float32 array (worlds, agents, flat_size), which
    joins all keys in their order. "rows": by key, with lists of the rows that agents see, see VisibleRows.

    Attributes:
        kind: One of KINDS.
        views: Observations of the engine, by key, read-only and unscaled, for any kind.
        space: The space of all agents of a world: Dict of Box (agents, ...), or Box (agents, flat_size). Lists have no
            fixed shape: with "rows" it is the same as with "dict", for names, shapes and bounds of columns.
        names: The names of the columns of a flat row: "own.health", "heals.3.x", "heals_mask.3".
    """

    def __init__(self, worlds: Worlds, kind: str, scaled: bool) -> None:
        """Raise ValueError for another kind. scaled: by scaling.Scale, so that all bounds are finite."""
        check_choice("observations", kind, KINDS)
        self.kind, self.scaled = kind, bool(scaled)
        found = published(worlds, Observation)
        self.views = {key: read_only(getattr(worlds[component], name)) for key, component, name, _ in found}
        self.flat_size = sum(math.prod(view.shape[2:]) for view in self.views.values())
        ends, fields, scales = bounds(worlds), worlds.layout.fields, list[Scale]()
        self._scales = dict[str, Scale]()
        for key, (low, high) in ends.items():
            scale = Scale.of(fields.get(key, {}), low.shape[-1])
            if self.scaled:
                scale, *ends[key] = scale.limited(low, high)  # type: ignore[assignment]
            self._scales[key] = scale
            scales += [scale] * math.prod(low.shape[1:-1])
        self._flat = joined(scales)
        shapes = {key: low.shape[1:] for key, (low, _) in ends.items()}
        self.names = [name for key, shape in shapes.items() for name in number_names(key, shape, fields.get(key, {}))]
        if kind == "flat":
            low, high = (
                np.concatenate([each[k].reshape(len(each[k]), -1) for each in ends.values()], 1) for k in (0, 1)
            )
            self.space: Any = spaces.Box(low, high, dtype=np.float32)
        else:
            self.space = spaces.Dict({key: spaces.Box(*each, dtype=np.float32) for key, each in ends.items()})
        self._buffer: Any = None
        self._lists = VisibleRows(self.views) if kind == "rows" else None

    def read(self, copy: bool) -> Any:
        """Return the observations now: new arrays, or without `copy` read-only views that the next call overwrites."""
        if self._lists is not None:
            return self._rows(self._lists, copy)
        if self.kind == "dict" and not self.scaled:
            return {key: view.copy() for key, view in self.views.items()} if copy else dict(self.views)
        room = self.room(_empty) if copy or self._buffer is None else self._buffer
        self.write(room)
        if copy:
            return room
        self._buffer = room
        return each(room, read_only)

    def _rows(self, lists: VisibleRows, copy: bool) -> Arrays:
        """Return the observations with lists of rows."""
        found = lists()
        if self.scaled or copy:
            found = {key: array.copy() for key, array in found.items()}
        for key in self._scales.keys() & found.keys() if self.scaled else ():
            self._scales[key].apply(found[key])
        return found

    def of_each(self, where: Array) -> Array:
        """Return a copy of the observations of each of the worlds `where`, None for the others; objects (worlds,)."""
        observations, found = self.read(copy=False), np.full(len(where), None, object)
        for w in np.flatnonzero(where):
            if self._lists is not None:
                found[w] = self._lists.of_world(observations, int(w))
            else:
                found[w] = each(observations, lambda array, w=w: array[w].copy())
        return found

    def check(self, out: Any, name: str = "out") -> Any:
        """Return the caller's memory, by key or flat, as numpy arrays, for `write`. Raises ValueError."""
        self.check_fixed()
        if not isinstance(out, Mapping):
            return writable(name, out, (*next(iter(self.views.values())).shape[:2], self.flat_size))
        if out.keys() != self.views.keys():
            raise ValueError(f"{name} has the keys {sorted(out, key=repr)}: {sorted(self.views)} are needed")
        return {key: writable(f"{name}[{key!r}]", out[key], view.shape) for key, view in self.views.items()}

    def write(self, arrays: Any) -> None:
        """Write the present observations, of either kind, into the result of `check`."""
        if isinstance(arrays, dict):
            for key, view in self.views.items():
                arrays[key][...] = view
                if self.scaled:
                    self._scales[key].apply(arrays[key])
            return
        start = 0
        for view in self.views.values():
            numbers = math.prod(view.shape[2:])
            arrays[:, :, start : start + numbers] = view.reshape(*view.shape[:2], numbers)
            start += numbers
        if self.scaled:
            self._flat.apply(arrays)

    def of_agent(self, i: int) -> Any:
        """Return the space of agent `i`, a new object: Dict of Box (...), or Box (flat_size,). Raises ValueError."""
        self.check_fixed()
        if self.kind == "flat":
            return spaces.Box(self.space.low[i], self.space.high[i], dtype=np.float32)
        return spaces.Dict(
            {key: spaces.Box(box.low[i], box.high[i], dtype=np.float32) for key, box in self.space.items()}
        )

    def room(self, empty: Any) -> Any:
        """Return memory for `write`: results of empty(shape), float32, by key or as one.

        Raises ValueError, as `check` and `of_agent` do, without a fixed shape.
        """
        self.check_fixed()
        if self.kind == "dict":
            return {key: empty(view.shape) for key, view in self.views.items()}
        return empty((*next(iter(self.views.values())).shape[:2], self.flat_size))

    def check_fixed(self) -> None:
        """Raise ValueError if observations have no fixed shape."""
        if self._lists is not None:
            raise ValueError(
                "observations = 'rows': lists of what agents see have another length in every step, and fixed shapes "
                "are needed here; take 'dict' or 'flat' (only make_vec has 'rows')"
            )


def _empty(shape: tuple[int, ...]) -> Array:
    return np.empty(shape, np.float32)


def each(observations: Any, change: Any) -> Any:
    """Apply `change` to each array of observations by key, or to flat ones."""
    return (
        {key: change(array) for key, array in observations.items()}
        if isinstance(observations, dict)
        else change(observations)
    )


def number_names(key: str, shape: Sequence[int], fields: Mapping[str, Field]) -> list[str]:
    """Return the names of the numbers that an agent has of a key, in order: "own.health", "heals.3.x"."""
    columns = column_names(fields) or [str(k) for k in range(shape[-1])]
    rows = [".".join(map(str, (key, *index))) for index in np.ndindex(*shape[:-1])]
    return [f"{one}.{column}" for one in rows for column in columns]


def writable(name: str, given: Any, shape: tuple[int, ...], dtype: Any = np.float32) -> Array:
    """Return the caller's memory as a numpy array.

    Args:
        name: Its name in errors.
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
    """Return a view that cannot be written to: the engine writes only changes, and relies on the rest."""
    view = array.view()
    view.flags.writeable = False
    return view
