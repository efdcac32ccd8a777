"""Observations as rows for the networks: one flat list of the entities that the agents of a batch see.

An agent sees one or two entities of the 17 to 36 that there are, so only those are kept, embedded and attended to.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from .observation_layout import ObservationLayout

Array = np.ndarray[Any, Any]


class Rows:
    """What a batch of agents observes.

    Attributes:
        own: float32 (batch, layout.own), each agent's own numbers.
        entities: float32 (rows, layout.columns), the entities that agents see, agent after agent. Each stands in the
            columns of its kind, with a 1 in the column that says which kind that is; the others are 0.
        count: int64 (batch,), how many of the rows are each agent's.
        state: float32 (batch, numbers), of each agent's whole world, for a critic that learns from it; or None.
    """

    def __init__(self, own: Tensor, entities: Tensor, count: Tensor, state: Tensor | None = None) -> None:
        self.own, self.entities, self.count, self.state = own, entities, count, state

    def __len__(self) -> int:
        return len(self.own)

    @cached_property
    def start(self) -> Tensor:
        """int64 (batch,), where each agent's rows begin."""
        return self.count.cumsum(0) - self.count

    @cached_property
    def agent(self) -> Tensor:
        """int64 (rows,), whose row each one is."""
        batch = torch.arange(len(self), device=self.count.device)
        return batch.repeat_interleave(self.count, output_size=len(self.entities))

    def select(self, index: Tensor) -> Rows:
        """Those of some agents, int64 (some,)."""
        count = self.count.index_select(0, index)
        shift = self.start.index_select(0, index) - (count.cumsum(0) - count)
        rows = shift.repeat_interleave(count)
        rows += torch.arange(len(rows), device=rows.device)
        own, entities = self.own.index_select(0, index), self.entities.index_select(0, rows)
        return Rows(own, entities, count, _selected(self.state, index))

    def to(self, device: torch.device) -> Rows:
        """The same on a device."""
        own, entities, count = (each.to(device, non_blocking=True) for each in (self.own, self.entities, self.count))
        return Rows(own, entities, count, _moved(self.state, device))


class PaddedRows:
    """What a batch of agents observes, with a row for each entity that there may be, seen or not.

    Attributes:
        packed: float32 (batch, layout.size).
        layout: What is where in it.
        state: As of Rows.
    """

    def __init__(self, packed: Tensor, layout: ObservationLayout, state: Tensor | None = None) -> None:
        self.packed, self.layout, self.state = packed, layout, state

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
        """Those of some agents, int64 (some,)."""
        return PaddedRows(self.packed.index_select(0, index), self.layout, _selected(self.state, index))

    def to(self, device: torch.device) -> PaddedRows:
        """The same on a device."""
        return PaddedRows(self.packed.to(device, non_blocking=True), self.layout, _moved(self.state, device))


Observed = Rows | PaddedRows


def concatenated(parts: Sequence[Observed]) -> Observed:
    """The batches one behind the other."""
    states = [part.state for part in parts if part.state is not None]
    state = torch.cat(states) if states else None
    if isinstance(first := parts[0], PaddedRows):
        packed = torch.cat([part.packed for part in cast(Sequence[PaddedRows], parts)])
        return PaddedRows(packed, first.layout, state)
    rows = cast(Sequence[Rows], parts)
    own, entities, count = (torch.cat([getattr(part, name) for part in rows]) for name in ("own", "entities", "count"))
    return Rows(own, entities, count, state)


def _selected(state: Tensor | None, index: Tensor) -> Tensor | None:
    return None if state is None else state.index_select(0, index)


def _moved(state: Tensor | None, device: torch.device) -> Tensor | None:
    return None if state is None else state.to(device, non_blocking=True)
