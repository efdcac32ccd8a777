"""Observations in the form for a learner, by key, flat or as lists, in units or scaled; the state for its critic."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from outlast.components import Body, Health, Item, SelfView, Shape, Side, Wall, ZoneView
from outlast.components.box import VERTICES
from outlast.ecs import Entity, Observation, Worlds
from outlast.ecs.declarations.fields import Field, Fields, column_names

from .spaces import bounds, published
from .validation import Array, check_choice
from .visible_rows import VisibleRows

KINDS = ("dict", "flat", "rows")
Arrays = dict[str, Array]
POSE = ("x", "y", "angle")
LIMIT = 10.0  # scaled values without a known range are clipped to it, as normalising wrappers do


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
        """Raise ValueError for another kind. scaled: Whether by Scale, so that all bounds are finite."""
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
            found = self._lists()
            if self.scaled or copy:
                found = {key: array.copy() for key, array in found.items()}
            for key in self._scales.keys() & found.keys() if self.scaled else ():
                self._scales[key].apply(found[key])
            return found
        if self.kind == "dict" and not self.scaled:
            return {key: view.copy() for key, view in self.views.items()} if copy else dict(self.views)
        room = self.room(lambda shape: np.empty(shape, np.float32)) if copy or self._buffer is None else self._buffer
        self.write(room)
        if copy:
            return room
        self._buffer = room
        return each(room, read_only)

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
        """Return memory for `write`: results of empty(shape), float32, by key or as one. May raise ValueError."""
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


def each(observations: Any, change: Any) -> Any:
    """Apply `change` to each array of observations by key, or to flat ones."""
    if isinstance(observations, dict):
        return {key: change(array) for key, array in observations.items()}
    return change(observations)


def number_names(key: str, shape: Sequence[int], fields: Mapping[str, Field]) -> list[str]:
    """Return the names of the numbers that an agent has of a key, in order: "own.health", "heals.3.x"."""
    columns = column_names(fields) or [str(k) for k in range(shape[-1])]
    rows = [".".join(map(str, (key, *index))) for index in np.ndindex(*shape[:-1])]
    return [f"{one}.{column}" for one in rows for column in columns]


def writable(name: str, given: Any, shape: tuple[int, ...], dtype: Any = np.float32) -> Array:
    """Return the caller's memory, an array or a tensor that shares its memory with numpy, as a numpy array.

    ValueError, which names it, if it has another shape or type, cannot be written to, or is on another device.
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


@dataclass(frozen=True)
class Scale:
    """Scales of the columns of a row."""

    divisors: Array  # of the columns, float32 (columns,)
    angles: Array  # indices of columns in radians, which are wrapped to -pi to pi first
    unlimited: Array  # indices of columns of unknown range, which are clipped to -LIMIT to LIMIT

    @classmethod
    def of(cls, fields: Mapping[str, Field], columns: int) -> "Scale":
        """Return the scale of a row with these fields, for any ranges; without fields, a row is not scaled."""
        divisors, angle = np.ones(columns, np.float32), np.zeros(columns, bool)
        for field in fields.values():
            divisors[field.columns], angle[field.columns] = field.scale, field.unit == "rad"
        return cls(divisors, np.flatnonzero(angle), np.zeros(0, int))

    def limited(self, low: Array, high: Array) -> tuple["Scale", Array, Array]:
        """Return the scale, clipped where one of the ends (..., columns) is infinite, and the ends of the result."""
        low, high = low.copy(), high.copy()
        low[..., self.angles], high[..., self.angles] = -np.float32(math.pi), np.float32(math.pi)
        endless = np.isinf(low) | np.isinf(high)
        scale = Scale(self.divisors, self.angles, np.flatnonzero(endless.any(axis=tuple(range(endless.ndim - 1)))))
        for ends, limit in ((low, -LIMIT), (high, LIMIT)):
            ends /= self.divisors
            at = ends[..., scale.unlimited]
            ends[..., scale.unlimited] = np.where(np.isinf(at), limit, np.clip(at, -LIMIT, LIMIT))
        return scale, low, high

    def apply(self, rows: Array) -> None:
        """Scale rows (..., columns) in place."""
        if len(self.angles):
            rows[..., self.angles] = np.remainder(rows[..., self.angles] + math.pi, math.tau) - math.pi
        rows /= self.divisors
        if len(self.unlimited):
            rows[..., self.unlimited] = np.clip(rows[..., self.unlimited], -LIMIT, LIMIT)


def joined(scales: list[Scale]) -> Scale:
    """Return the scale of rows that are concatenated into one."""
    starts = np.cumsum([0, *(len(scale.divisors) for scale in scales)])[:-1]
    shifted = [(scale.angles + at, scale.unlimited + at) for scale, at in zip(scales, starts, strict=True)]
    angles, unlimited = (np.concatenate(each) for each in zip(*shifted, strict=True))
    return Scale(np.concatenate([scale.divisors for scale in scales]), angles, unlimited)


def scaled(observations: Mapping[str, Array], fields: Fields) -> dict[str, Array]:
    """Divide observations by the scales of their fields; angles (rad) are wrapped to -pi to pi first.

    >>> seen = outlast.adapters.scaled(observations, env.fields)

    Environments with scaled=True do that themselves, and also clip columns without bounds.

    Args:
        observations: By key, float32 (..., length of a row), from any adapter.
        fields: `fields` of the environment that made them, or of its `base_env`.

    Returns:
        New arrays of the same shapes. Ids, masks and keys without fields are unchanged; rows of zeros stay zero.

    Raises:
        KeyError: `fields` has a key that is not among the observations.
    """
    found = dict(observations)
    for key, named in fields.items():
        row: Array = np.array(observations[key], np.float32)
        Scale.of(named, row.shape[-1]).apply(row)
        found[key] = row
    return found


class Block(NamedTuple):
    """Equal rows of the state."""

    names: list[str]  # of their numbers
    ends: Array  # for each number low, high, scale and whether it is in radians, float32 (4, numbers)
    read: Callable[[Any], Array]  # returns the rows of some worlds, (..., rows, numbers of a row)


class GlobalState:
    """The state of one world as one float32 vector, including what no agent sees.

    It consists of these blocks of rows, in this order; for absent entities, all but the flags are 0:

    ======= ===================================================================================
    agents  alive (0, 1), then the row `own` of their observation, with its fields
    zone    the row `zone` of agent_0's observation; only if the scenario has one
    objects stands (0, 1), x, y, angle, half width, half height, hit points: boxes, and other things with hit points
    items   lies on the ground (0, 1), x, y, and its carrier: 0 none, 1 agent_0, 2 agent_1 ...
    walls   stands (0, 1), x, y, angle, half width, half height: blocks inside the room
    bodies  stands (0, 1), x, y, angle: all others, such as a ball, except the four walls around the room
    numbers those that vary (Scenario.vary), in order of names, except words and lists of numbers
    ======= ===================================================================================

    Objects, items, walls and bodies are in the order of their rows (see `Worlds.span` for the rows of kinds).

    Attributes:
        space: The space of the vector.
        names: The names of its numbers: "agent_0.health", "zone.x", "box_3.stands" ...
        scale: Divisors that bring its numbers to about -1 to 1, float32 like the vector.
    """

    def __init__(self, worlds: Worlds, scaled: bool = False) -> None:
        """Prepare it. scaled: Whether to divide by the scales, wrap angles and clip numbers without bounds."""
        rows = worlds.layout.rows
        self.worlds, self.first = worlds, worlds.span("agent").start
        self.agents, self.items = rows(Side), rows(Item, Body)
        self.walls = rows(Wall)
        self.objects = np.setdiff1d(rows(Body, Shape, Health), np.concatenate([self.agents, self.items]))
        around = worlds.layout.spans.get("wall", range(0))
        known = np.concatenate([self.agents, self.items, self.objects, self.walls, around])
        self.bodies = np.setdiff1d(rows(Body), known)
        self.numbers = {name: n for name, n in worlds.layout.varied.items() if n.kind in (bool, int, float)}
        self._blocks = [block for block in self._declared() if block.names]
        low, high, self.scale, radians = np.concatenate([block.ends for block in self._blocks], 1, dtype=np.float32)
        self.names = [name for block in self._blocks for name in block.names]
        self._scale: Scale | None = None
        if scaled:
            self._scale, low, high = Scale(self.scale, np.flatnonzero(radians), np.zeros(0, int)).limited(low, high)
        self.space = spaces.Box(low, high, dtype=np.float32)

    def __call__(self, w: int | slice = 0) -> Array:
        """Return the vector of world `w`, or of some worlds, (worlds, numbers): a new array."""
        parts = [block.read(w) for block in self._blocks]
        state = np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], -1, dtype=np.float32)
        if self._scale is not None:
            self._scale.apply(state)
        return state

    def _declared(self) -> Iterator[Block]:
        """Yield the blocks."""
        worlds, known, fields, flag = self.worlds, bounds(self.worlds), self.worlds.layout.fields, _column(0, 1)
        x, y, angle = np.hsplit(np.vstack([[[-np.inf] * 3, [np.inf] * 3], self._units("own", *POSE)]), 3)
        half, size = _column(scale=VERTICES.scale), ("half_width", "half_height")
        pose, sides = ([getattr(worlds[kind], name) for name in names] for kind, names in ((Body, POSE), (Shape, size)))

        def block(rows: Array, names: Sequence[str], ends: Sequence[Array], read: Callable[[Any], Array]) -> Block:
            entities = [worlds.layout.entity_names[row].replace(" ", "_") for row in rows]
            called = [f"{entity}.{name}" for entity in entities for name in names]
            return Block(called, np.tile(np.hstack(ends), len(rows)), read)

        def standing(rows: Array, names: Sequence[str], ends: Sequence[Array], columns: list[Array]) -> Block:
            return block(rows, ("stands", *names), (flag, *ends), lambda w: self._standing(w, rows, columns))

        def seen(key: str) -> tuple[list[str], Array]:
            return column_names(fields.get(key, {})), np.vstack([*np.stack(known[key])[:, 0], self._units(key)])

        own, ends = seen("own")
        yield block(self.agents, ("alive", *own), (flag, ends), self._agents)
        if ZoneView in worlds:
            zone, ends = seen("zone")  # differs between agents only in fields of mechanics of one's own
            yield Block([f"zone.{name}" for name in zone], ends, lambda w: worlds[ZoneView].zone[w, :1])
        health, points = _column(scale=self._toughest()), worlds[Health].points
        solid = (x, y, angle, half, half)
        yield standing(self.objects, (*POSE, *size, "health"), (*solid, health), [*pose, *sides, points])
        carrier = _column(0, len(self.agents), len(self.agents))
        yield block(self.items, ("lies", "x", "y", "carrier"), (flag, x, y, carrier), self._items)
        yield standing(self.walls, (*POSE, *size), solid, [*pose, *sides])
        yield standing(self.bodies, POSE, (x, y, angle), pose)
        extremes = [[*map(float, number.distribution.extremes())] for number in self.numbers.values()]
        drawn = [_column(low, high, max(abs(low), abs(high), 1e-3)) for low, *_, high in extremes]
        yield Block([f"numbers.{name}" for name in self.numbers], np.hstack(drawn or [flag]), self._numbers)

    def _units(self, key: str, *names: str) -> Array:
        """Return the scale, and whether in radians, (2, columns), of these fields of an observation, or of all."""
        fields = self.worlds.layout.fields[key]
        chosen = [fields[name] for name in names or fields]
        return np.hstack([np.full((2, field.size), [[field.scale], [field.unit == "rad"]]) for field in chosen])

    def _toughest(self) -> float:
        """Return the maximum hit points of an object at the start; 1 without objects."""
        points = self.worlds.layout.prefab_values(Health, "points")
        spans = {name: self.worlds.span(name) for name in points}
        return max([1.0, *(float(np.max(points[name])) for name in points if spans[name].start in self.objects)])

    def _agents(self, w: int | slice) -> Array:
        alive = self.worlds[Entity].alive[w][..., self.agents]
        return np.concatenate([alive[..., None], self.worlds[SelfView].own[w]], -1)

    def _items(self, w: int | slice) -> Array:
        body, holder = self.worlds[Body], self.worlds[Item].holder[w][..., self.items]
        rows = self._standing(w, self.items, [body.x, body.y])
        return np.concatenate([rows, np.where(holder >= 0, holder - self.first + 1, 0)[..., None]], -1)

    def _numbers(self, w: int | slice) -> Array:
        known = self.worlds.numbers()
        return np.stack([known[name][w] for name in self.numbers], -1)[..., None, :]

    def _standing(self, w: int | slice, rows: Array, columns: list[Array]) -> Array:
        """Return whether each row is in the world, followed by its columns, which are 0 if it is not."""
        alive = self.worlds[Entity].alive[w][..., rows]
        return np.stack([alive, *(np.where(alive, column[w][..., rows], 0) for column in columns)], -1)


def _column(low: float = -np.inf, high: float = np.inf, scale: float = 1.0) -> Array:
    return np.array([[low], [high], [scale], [False]], np.float32)
