"""Observations as rows for the networks: one flat list of the entities that the agents of a batch see.

An agent sees one or two entities of the 17 to 36 that there are, so only those are kept, embedded and attended to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .observation_layout import MASK, OWN, ObservationLayout

Array = np.ndarray[Any, Any]
FILL = 512  # multiple that lists are filled up to where shapes are to repeat


def moved(tensor: Tensor, device: torch.device) -> Tensor:
    """The tensor on a device; it comes to a GPU through pinned memory, so that nobody waits for it."""
    if device.type == "cuda" and tensor.device.type == "cpu" and torch.cuda.is_available():
        tensor = tensor.pin_memory()
    return tensor.to(device, non_blocking=True)


class Rows:
    """What a batch of agents observes.

    Attributes:
        own: float32 (batch, layout.own), each agent's own numbers.
        entities: float32 (rows, layout.columns), the entities that agents see, agent after agent. Each stands in the
            columns of its kind, with a 1 in the column that says which kind that is; the others are 0.
        count: int64 (batch,), how many of the rows are each agent's.
        known: The same as an array, by which the CPU knows all sizes and waits for no GPU.
        room: How many pairs there is room for, or None. If not, there are rows and pairs of nobody behind all others,
            one of each at least, so that their numbers are multiples of FILL: a GPU meets the same shapes again.
    """

    def __init__(
        self, own: Tensor, entities: Tensor, count: Tensor, known: Array | None = None, room: int | None = None
    ) -> None:
        self.own, self.entities, self.count, self.room = own, entities, count, room
        self.known = count.numpy() if known is None else known

    def __len__(self) -> int:
        return len(self.own)

    @cached_property
    def start(self) -> Tensor:
        """int64 (batch,), where each agent's rows begin."""
        return self.count.cumsum(0) - self.count

    @property
    def owners(self) -> int:
        """How many agents rows can be of: nobody is one, where there is room for more."""
        return len(self) + (self.room is not None)

    @cached_property
    def agent(self) -> Tensor:
        """int64 (rows,), whose row each one is."""
        owners = torch.arange(self.owners, device=self.count.device)
        return owners.repeat_interleave(self._counts(len(self.entities)), output_size=len(self.entities))

    @cached_property
    def each(self) -> Tensor:
        """int64 (rows,), how many pairs each row is the first of: as many as its agent has rows."""
        if self.room is None:
            return self.count.index_select(0, self.agent)
        each = functional.pad(self.count, (0, 1)).index_select(0, self.agent)
        each[-1] = self.room - each.sum()  # the last row has what is left
        return each

    @cached_property
    def pairs(self) -> tuple[Tensor, Tensor]:
        """The pairs of rows of one agent, int64 (pairs,) each: all with the first row, all with the second ..."""
        rows = torch.arange(len(self.entities), device=self.count.device)
        first = rows.repeat_interleave(self.each, output_size=self.room)
        start = self.start if self.room is None else functional.pad(self.start, (0, 1), value=len(rows) - 1)
        shift = start.index_select(0, self.agent) - (self.each.cumsum(0) - self.each)
        second = torch.arange(len(first), device=first.device) + shift.index_select(0, first)
        return first, second if self.room is None else second.clamp(max=len(rows) - 1)

    def select(self, index: Tensor) -> Rows:
        """Those of some agents, int64 (some,), on the CPU."""
        known, there = self.known[index.numpy()], moved(index, self.count.device)
        found = Rows(self.own.index_select(0, there), self.entities, self.count.index_select(0, there), known)
        size, last = int(known.sum()), len(self.entities) - 1
        if self.room is not None:
            size, found.room = _filled(size), _filled(int((known * known).sum()))
        shift = self.start.index_select(0, there) - found.start
        if self.room is not None:
            shift = functional.pad(shift, (0, 1))
        rows = shift.repeat_interleave(found._counts(size), output_size=size)
        rows += torch.arange(size, device=rows.device)
        found.entities = self.entities.index_select(0, rows if self.room is None else rows.clamp(max=last))
        return found

    def filled(self) -> Rows:
        """The same with room for more."""
        size, pairs = len(self.entities), int((self.known * self.known).sum())
        entities = functional.pad(self.entities, (0, 0, 0, _filled(size) - size))
        return Rows(self.own, entities, self.count, self.known, _filled(pairs))

    def to(self, device: torch.device) -> Rows:
        """The same on a device; with room for more, unless that is the CPU."""
        if device == self.own.device:
            return self
        here = self if device.type == "cpu" else self.filled()
        own, entities, count = (moved(each, device) for each in (here.own, here.entities, here.count))
        return Rows(own, entities, count, self.known, here.room)

    def _counts(self, size: int) -> Tensor:
        """int64 (owners,), how many of so many rows are each agent's, and nobody's."""
        if self.room is None:
            return self.count
        return torch.cat([self.count, (size - self.count.sum())[None]])


class PaddedRows:
    """What a batch of agents observes, with a row for each entity that there may be, seen or not.

    Attributes:
        packed: float32 (batch, layout.size).
        layout: What is where in it.
    """

    def __init__(self, packed: Tensor, layout: ObservationLayout) -> None:
        self.packed, self.layout = packed, layout

    def __len__(self) -> int:
        return len(self.packed)

    @property
    def own(self) -> Tensor:
        """float32 (batch, layout.own), each agent's own numbers."""
        return self.packed[:, : self.layout.own]

    @property
    def seen(self) -> Tensor:
        """float32 (batch, layout.rows), 1 for each entity that is seen."""
        return self.packed[:, self.layout.own : self.layout.own + self.layout.rows]

    @property
    def rows(self) -> Tensor:
        """float32 (batch, layout.rows, layout.features), the entities, filled up with zeros."""
        cells = self.packed[:, self.layout.own + self.layout.rows :]
        return cells.view(len(self), self.layout.rows, self.layout.features)

    def select(self, index: Tensor) -> PaddedRows:
        """Those of some agents, int64 (some,), on the CPU."""
        return PaddedRows(self.packed.index_select(0, moved(index, self.packed.device)), self.layout)

    def to(self, device: torch.device) -> PaddedRows:
        """The same on a device."""
        return PaddedRows(moved(self.packed, device), self.layout)


Observed = Rows | PaddedRows


class Packer:
    """Packs observations, by key and kind, as the networks of a preset take them."""

    def __init__(self, layout: ObservationLayout, *, leaky: bool) -> None:
        """leaky: with the rows of what is hidden."""
        self.layout, self.leaky = layout, leaky

    def __call__(self, observations: Mapping[str, Array]) -> Observed:
        """Pack the observations of a batch of agents.

        Args:
            observations: float32 (..., *layout.shapes[key]) by key; the agents of the leading axes are the batch.
        """
        return self._padded(observations) if self.leaky else self._rows(observations)

    def _padded(self, observations: Mapping[str, Array]) -> PaddedRows:
        batch = observations[OWN].size // self.layout.shapes[OWN][0]
        packed = np.zeros((batch, self.layout.size), np.float32)
        for key, view in self.layout.views(packed).items():
            view[...] = observations[key].reshape(view.shape)
        return PaddedRows(torch.from_numpy(packed), self.layout)

    def _rows(self, observations: Mapping[str, Array]) -> Rows:
        own = np.concatenate([observations[key].reshape(-1, width) for key, width in self.layout.alone.items()], 1)
        seen = {kind: np.flatnonzero(observations[kind.key + MASK]) for kind in self.layout.kinds}
        agent = np.concatenate([rows // kind.rows for kind, rows in seen.items()] or [np.zeros(0, np.int64)])
        entities, row, column = np.zeros((len(agent), self.layout.columns), np.float32), 0, 0
        for k, (kind, rows) in enumerate(seen.items()):
            here = entities[row : row + len(rows)]
            here[:, column : column + kind.features] = observations[kind.key].reshape(-1, kind.features)[rows]
            here[:, k - len(seen)] = 1
            row, column = row + len(rows), column + kind.features
        order, count = np.argsort(agent, kind="stable"), np.bincount(agent, minlength=len(own))
        return Rows(torch.from_numpy(own), torch.from_numpy(entities[order]), torch.from_numpy(count))


def concatenated(parts: Sequence[Observed]) -> Observed:
    """The batches one behind the other."""
    if isinstance(first := parts[0], PaddedRows):
        return PaddedRows(torch.cat([part.packed for part in cast(Sequence[PaddedRows], parts)]), first.layout)
    rows = cast(Sequence[Rows], parts)
    known = np.concatenate([part.known for part in rows])
    entities = torch.cat([part.entities[: int(part.known.sum())] for part in rows])
    own, count = (torch.cat([getattr(part, name) for part in rows]) for name in ("own", "count"))
    joined = Rows(own, entities, count, known)
    return joined if rows[0].room is None else joined.filled()


def _filled(size: int) -> int:
    """The next multiple of FILL: at least one more."""
    return (size // FILL + 1) * FILL
