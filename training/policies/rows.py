"""Observations as rows for the networks: one flat list of the entities that a batch of agents sees.

An agent sees one or two of 17 to 36 entities, so only these are kept, embedded and attended to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import torch
from torch import Tensor
from torch.nn import functional

from ..base.observation_layout import ObservationLayout

FILL = 512  # lists are padded to multiples of this where shapes should repeat


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
        found.state = _selected(self.state, there)
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
        return Rows(own, entities, count, self.known, here.room, _moved(self.state, device))

    def _counts(self, size: int) -> Tensor:
        """int64 (owners,), the number of `size` rows of each agent, and of unowned rows."""
        if self.room is None:
            return self.count
        return torch.cat([self.count, (size - self.count.sum())[None]])


@dataclass(eq=False)
class PaddedRows:
    """Observations of a batch of agents, with a row for each possible entity, seen or not.

    packed: float32 (batch, layout.size). layout: Layout of `packed`.
    """

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
        return PaddedRows(self.packed.index_select(0, there), self.layout, _selected(self.state, there))

    def to(self, device: torch.device) -> PaddedRows:
        """Return the observations on a device."""
        return PaddedRows(moved(self.packed, device), self.layout, _moved(self.state, device))


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


def _selected(state: Tensor | None, index: Tensor) -> Tensor | None:
    return None if state is None else state.index_select(0, index)


def _moved(state: Tensor | None, device: torch.device) -> Tensor | None:
    return None if state is None else moved(state, device)
