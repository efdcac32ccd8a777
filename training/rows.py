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
    """

    def __init__(self, own: Tensor, entities: Tensor, count: Tensor) -> None:
        self.own, self.entities, self.count = own, entities, count

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
        return Rows(self.own.index_select(0, index), self.entities.index_select(0, rows), count)

    def to(self, device: torch.device) -> Rows:
        """The same on a device."""
        return Rows(*(each.to(device, non_blocking=True) for each in (self.own, self.entities, self.count)))


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
        """Those of some agents, int64 (some,)."""
        return PaddedRows(self.packed.index_select(0, index), self.layout)

    def to(self, device: torch.device) -> PaddedRows:
        """The same on a device."""
        return PaddedRows(self.packed.to(device, non_blocking=True), self.layout)


Observed = Rows | PaddedRows


def concatenated(parts: Sequence[Observed]) -> Observed:
    """The batches one behind the other."""
    if isinstance(first := parts[0], PaddedRows):
        return PaddedRows(torch.cat([part.packed for part in cast(Sequence[PaddedRows], parts)]), first.layout)
    rows = cast(Sequence[Rows], parts)
    return Rows(*(torch.cat([getattr(part, name) for part in rows]) for name in ("own", "entities", "count")))
