"""Observations as rows for the networks: one flat list of the entities that a batch of agents sees.

An agent sees one or two of 17 to 36 entities, so only these are kept, embedded and attended to.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from outlast.ecs.kernels.jit import kernel, loader, storer
from outlast.envs.core.visible_rows import START, VisibleRows, called

from ..base.errors import TrainingError
from ..base.observation_layout import OWN, ObservationLayout
from ..base.presets import Form, Preset

Array = np.ndarray[Any, Any]
FILL = 512  # lists are padded to multiples of this where shapes should repeat
ANGLE = "angle"
VECTORS = {  # the fields of a vector: the first field of the agent's own vector that is subtracted from it
    ("x", "y"): "x",
    ("next_x", "next_y"): "x",
    ("vx", "vy"): "vx",
}
ME = ("x", "y", "vx", "vy", ANGLE)
MOVED = {"x": 2, "vx": 0, ANGLE: 0}  # of itself, an agent observes the position of the room's middle, and its velocity
TURN = 5  # numbers of a turn: columns of x and y (-1: an angle), those of the origin, and how often it is subtracted
KIND = 6  # numbers of a kind: addresses of its list, of starts and of turns; columns, the first one here, turns
word, read, write, write_word = loader("int64"), loader("float32"), storer("float32"), storer("int64")


def moved(tensor: Tensor, device: torch.device) -> Tensor:
    """Return the tensor on a device; to a GPU through pinned memory, so that the CPU does not wait."""
    if device.type == "cuda" and tensor.device.type == "cpu" and torch.cuda.is_available():
        tensor = tensor.pin_memory()
    return tensor.to(device, non_blocking=True)


@dataclass(eq=False)
class Rows:
    """Observations of a batch of agents.

    Attributes:
        own: float32 (batch, layout.own), each agent's own numbers.
        entities: float32 (rows, layout.columns), the entities that agents see, agent after agent. Each has its
            numbers in the columns of its kind, and a 1 in the column of its kind; the others are 0.
        count: int64 (batch,), number of rows of each agent.
        known: The same as an array, which gives the CPU all sizes without waiting for a GPU.
        room: Capacity for pairs, or None. With a capacity, rows and pairs without an owner, at least one of each,
            follow all others and pad the lists to multiples of FILL, so that shapes repeat on a GPU.
        state: float32 (batch, numbers), the state of each agent's world, for a critic that learns from it; or None.
    """

    own: Tensor
    entities: Tensor
    count: Tensor
    known: Any = None
    room: int | None = None
    state: Tensor | None = None

    def __post_init__(self) -> None:
        self.known = self.count.numpy() if self.known is None else self.known

    def __len__(self) -> int:
        return len(self.own)

    @cached_property
    def start(self) -> Tensor:
        """int64 (batch,), index of each agent's first row."""
        return self.count.cumsum(0) - self.count

    @property
    def owners(self) -> int:
        """Return the number of owners of rows: the agents and, for padded lists, one for unowned rows."""
        return len(self) + (self.room is not None)

    @cached_property
    def agent(self) -> Tensor:
        """int64 (rows,), the agent of each row."""
        owners = torch.arange(self.owners, dtype=torch.int64, device=self.count.device)
        return owners.repeat_interleave(self._counts(len(self.entities)), output_size=len(self.entities))

    @cached_property
    def each(self) -> Tensor:
        """int64 (rows,), the number of pairs with each row as the first: the number of its agent's rows."""
        if self.room is None:
            return self.count.index_select(0, self.agent)
        each = functional.pad(self.count, (0, 1)).index_select(0, self.agent)
        each[-1] = self.room - each.sum()  # the last row is the first in all remaining pairs
        return each

    @cached_property
    def pairs(self) -> tuple[Tensor, Tensor]:
        """The pairs of rows of one agent, int64 (pairs,) each: all with the first row, all with the second ..."""
        rows = torch.arange(len(self.entities), dtype=torch.int64, device=self.count.device)
        first = rows.repeat_interleave(self.each, output_size=self.room)
        start = self.start if self.room is None else functional.pad(self.start, (0, 1), value=len(rows) - 1)
        shift = start.index_select(0, self.agent) - (self.each.cumsum(0) - self.each)
        second = torch.arange(len(first), dtype=torch.int64, device=first.device) + shift.index_select(0, first)
        return first, second if self.room is None else second.clamp(max=len(rows) - 1)

    def select(self, index: Tensor) -> Rows:
        """Return the observations of some agents. index: Their indices, int64 (some,), on the CPU."""
        known, there = self.known[index.numpy()], moved(index, self.count.device)
        found = Rows(self.own.index_select(0, there), self.entities, self.count.index_select(0, there), known)
        found.state = None if self.state is None else self.state.index_select(0, there)
        size, last = int(known.sum()), len(self.entities) - 1
        if self.room is not None:
            size, found.room = _filled(size), _filled(int((known * known).sum()))
        shift = self.start.index_select(0, there) - found.start
        if self.room is not None:
            shift = functional.pad(shift, (0, 1))
        rows = shift.repeat_interleave(found._counts(size), output_size=size)
        rows += torch.arange(size, dtype=torch.int64, device=rows.device)
        found.entities = self.entities.index_select(0, rows if self.room is None else rows.clamp(max=last))
        return found

    def filled(self) -> Rows:
        """Return a copy with padded lists, see `room`."""
        size, pairs = len(self.entities), int((self.known * self.known).sum())
        entities = functional.pad(self.entities, (0, 0, 0, _filled(size) - size))
        return Rows(self.own, entities, self.count, self.known, _filled(pairs), self.state)

    def to(self, device: torch.device) -> Rows:
        """Return the observations on a device: padded on a GPU, and unchanged on the CPU."""
        if device.type == self.own.device.type:
            return self
        here = self.filled()
        own, entities, count = (moved(each, device) for each in (here.own, here.entities, here.count))
        return Rows(
            own, entities, count, self.known, here.room, None if self.state is None else moved(self.state, device)
        )

    def _counts(self, size: int) -> Tensor:
        """int64 (owners,), the number of `size` rows of each agent, and of unowned rows."""
        if self.room is None:
            return self.count
        return torch.cat([self.count, (size - self.count.sum())[None]])


@dataclass(eq=False)
class PaddedRows:
    """Observations of a batch of agents, with a row for each possible entity: packed, float32 (batch, layout.size)."""

    packed: Tensor
    layout: ObservationLayout
    state: Tensor | None = None

    def __len__(self) -> int:
        return len(self.packed)

    @property
    def own(self) -> Tensor:
        """float32 (batch, layout.own), each agent's own numbers."""
        return self.packed[:, : self.layout.own]

    @property
    def seen(self) -> Tensor:
        """float32 (batch, layout.rows), 1 for each visible entity."""
        return self.packed[:, self.layout.own : self.layout.own + self.layout.rows]

    @property
    def rows(self) -> Tensor:
        """float32 (batch, layout.rows, layout.features), the entities, padded with zeros."""
        cells = self.packed[:, self.layout.own + self.layout.rows :]
        return cells.view(len(self), self.layout.rows, self.layout.features)

    def select(self, index: Tensor) -> PaddedRows:
        """Return the observations of some agents. index: Their indices, int64 (some,), on the CPU."""
        there = moved(index, self.packed.device)
        return PaddedRows(
            self.packed.index_select(0, there),
            self.layout,
            None if self.state is None else self.state.index_select(0, there),
        )

    def to(self, device: torch.device) -> PaddedRows:
        """Return the observations on a device."""
        return PaddedRows(
            moved(self.packed, device), self.layout, None if self.state is None else moved(self.state, device)
        )


Observed = Rows | PaddedRows


def concatenated(parts: Sequence[Observed]) -> Observed:
    """Concatenate batches, all on the CPU."""
    states = [part.state for part in parts if part.state is not None]
    state = torch.cat(states) if states else None
    if isinstance(first := parts[0], PaddedRows):
        packed = torch.cat([part.packed for part in cast(Sequence[PaddedRows], parts)])
        return PaddedRows(packed, first.layout, state)
    rows = cast(Sequence[Rows], parts)
    own, entities, count = (torch.cat([getattr(part, name) for part in rows]) for name in ("own", "entities", "count"))
    return Rows(own, entities, count, state=state)


def _filled(size: int) -> int:
    """Round up to a multiple of FILL or, if that is more, of the highest power of 2 up to a sixteenth of `size`."""
    step = max(FILL, 1 << max(size.bit_length() - 5, 0))
    return (size // step + 1) * step


def turns(layout: ObservationLayout) -> list[Array]:
    """Return the turns that bring rows into the frame of the observing agent: it is at the origin and looks along x.

    Positions become relative to the agent's, velocities to its own, angles of others to its own, from -pi to pi.
    Returns int64 (turns, TURN) for an agent's own numbers, and then for each kind. Raises TrainingError if the layout
    lacks the agent's own position, velocity or angle.
    """
    columns = layout.field_columns()
    if not columns[OWN].keys() >= {*ME}:
        raise TrainingError(f"preset fast needs the fields {', '.join(ME)} of '{OWN}'; take another preset")
    own = [each for key in layout.alone for each in _turns(columns[key], columns[OWN], MOVED if key == OWN else {})]
    kinds = [_turns(columns[kind.key], columns[OWN], {}) for kind in layout.kinds]
    return [np.array(each, np.int64).reshape(-1, TURN) for each in (own, *kinds)]


def _turns(columns: Mapping[str, int], me: Mapping[str, int], moved: Mapping[str, int]) -> list[tuple[int, ...]]:
    found: list[tuple[int, ...]] = [
        (columns[x], columns[y], me[origin], me[origin.replace("x", "y")], moved.get(x, 1))
        for (x, y), origin in VECTORS.items()
        if x in columns and y in columns
    ]
    angles = [(columns[ANGLE], -1, me[ANGLE], 0, moved.get(ANGLE, 1))] if ANGLE in columns else []
    return found + angles


@kernel
def turn(row: int, me: int, angle: int, turned: int, count: int) -> None:
    """Turn a row in place. row, me: Addresses of the numbers of the row, and the agent's own as observed.

    angle: Column of the agent's angle. turned: Address of the turns. count: Number of turns.
    """
    if count == 0:
        return
    ahead = read(me + 4 * angle)
    cosine, sine = np.float32(math.cos(ahead)), np.float32(math.sin(ahead))
    for t in range(turned, turned + 8 * TURN * count, 8 * TURN):
        x, y, factor = row + 4 * word(t), row + 4 * word(t + 8), np.float32(word(t + 32))
        dx = read(x) - read(me + 4 * word(t + 16)) * factor
        if word(t + 8) < 0:
            around = np.float32(2 * math.pi)
            shifted = dx + np.float32(math.pi)
            write(x, shifted - around * np.float32(math.floor(shifted / around)) - np.float32(math.pi))
        else:
            dy = read(y) - read(me + 4 * word(t + 24)) * factor
            write(x, cosine * dx + sine * dy)
            write(y, cosine * dy - sine * dx)


@kernel
def pack(
    agents: int, own: int, turned: int, own_columns: int, angle: int, own_turns: int, own_count: int, kinds: int,
    lists: int, entities: int, columns: int, count: int,
) -> int:  # fmt: skip
    """Join the lists of all kinds to one of all entities, agent after agent. Arguments are addresses, or numbers of.

    own: float32 (agents, own_columns), the agents' own numbers, with their angle in the column `angle`. own_turns: See
    `turns`; own_count of them. lists: int64 (kinds, KIND). Written are turned: the own numbers after the turns;
    entities: float32 (n, columns), where columns are those of all kinds, and one for each kind; and count: int64
    (agents,), the number of entities of each agent.
    """
    to = entities
    for i in range(agents):
        seen = 0
        for k in range(kinds):
            kind = lists + 8 * KIND * k
            start, features, first = word(kind + 8) + 8 * i, word(kind + 24), word(kind + 32)
            for row in range(word(start), word(start + 8)):
                for c in range(columns):
                    write(to + 4 * c, np.float32(c == columns - kinds + k))
                for c in range(features):
                    write(to + 4 * (first + c), read(word(kind) + 4 * (row * features + c)))
                turn(to, own, angle, word(kind + 16), word(kind + 40))
                to += 4 * columns
                seen += 1
        write_word(count + 8 * i, seen)
        for c in range(own_columns):
            write(turned + 4 * c, read(own + 4 * c))
        turn(turned, own, angle, own_turns, own_count)
        own, turned = own + 4 * own_columns, turned + 4 * own_columns
    return 0


def packers_of(layout: ObservationLayout, presets: Iterable[Preset]) -> dict[Form, Packer]:
    """Return a packer for each form that networks of these presets take. Raises TrainingError, see Packer."""
    return {form: Packer(layout, form) for form in dict.fromkeys(each.form for each in presets)}


class Packer:
    """A packer of observations, by key and kind, in the form for the networks of a preset."""

    def __init__(self, layout: ObservationLayout, form: Form) -> None:
        """Make a packer for the networks of presets of that form.

        If it is leaky, the rows of hidden entities are packed, too. If egocentric, what is seen is brought into the
        frame of the agent, in which it acts (ahead, to the left, turn): otherwise, a network would have to learn to
        subtract and to rotate. Raises TrainingError if the layout lacks the fields for that, see `turns`.
        """
        self.layout, (self.leaky, egocentric) = layout, form
        none: list[Array] = [np.zeros((0, 0), np.int64)] * (1 + len(layout.kinds))
        self._turns = turns(layout) if egocentric else none
        self._angle = layout.field_columns()[OWN][ANGLE] if egocentric else 0

    def __call__(self, observations: Mapping[str, Array]) -> Observed:
        """Pack observations by key, float32 (..., *layout.shapes[key]) or lists, see make_vec(observations="rows")."""
        if not self.leaky:
            return self._rows(observations)
        batch = observations[OWN].size // self.layout.shapes[OWN][0]
        packed = np.zeros((batch, self.layout.size), np.float32)
        for key, view in self.layout.views(packed).items():
            view[...] = observations[key].reshape(view.shape)
        return PaddedRows(torch.from_numpy(packed), self.layout)

    def own(self, observations: Mapping[str, Array]) -> Array:
        """Return the numbers that belong to no entity, as observed: float32 (batch, layout.own)."""
        return np.concatenate([observations[key].reshape(-1, width) for key, width in self.layout.alone.items()], 1)

    def _rows(self, observations: Mapping[str, Array]) -> Rows:
        own = self.own(observations)
        if any(kind.key + START not in observations for kind in self.layout.kinds):
            batch = {key: observations[key].reshape(1, len(own), *shape) for key, shape in self.layout.shapes.items()}
            observations = VisibleRows(batch)()
        lists, kept, first, size = [], list[Array](), 0, 0  # kept: the arrays at the addresses in `lists`
        for kind, turned in zip(self.layout.kinds, self._turns[1:], strict=True):
            rows = np.ascontiguousarray(observations[kind.key], np.float32)
            start = np.ascontiguousarray(observations[kind.key + START], np.int64)
            kept += [rows, start]
            places = rows.ctypes.data, start.ctypes.data, turned.ctypes.data
            lists.append((*places, kind.features, first, len(turned)))
            first, size = first + kind.features, size + len(rows)
        own, columns, table = np.ascontiguousarray(own, np.float32), self.layout.columns, np.array(lists, np.int64)
        turned, count = np.empty_like(own), np.empty(len(own), np.int64)
        entities = np.empty((size, columns), np.float32)
        called(pack)[0](
            len(own), own.ctypes.data, turned.ctypes.data, own.shape[1], self._angle, self._turns[0].ctypes.data,
            len(self._turns[0]), len(lists), table.ctypes.data, entities.ctypes.data, columns, count.ctypes.data,
        )  # fmt: skip
        return Rows(torch.from_numpy(turned), torch.from_numpy(entities), torch.from_numpy(count))
