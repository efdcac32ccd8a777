"""Turns the observations of worlds into the rows that networks take."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from ..base.observation_layout import MASK, OWN, ObservationLayout
from .egocentric import Egocentric
from .rows import Observed, PaddedRows, Rows

Array = np.ndarray[Any, Any]


class Packer:
    """Packs observations, by key and kind, in the form that the networks of a preset take."""

    def __init__(self, layout: ObservationLayout, *, leaky: bool, egocentric: bool) -> None:
        """Make a packer for the networks of a preset.

        leaky: Whether the rows of hidden entities are packed, too. egocentric: Whether what is seen is brought into the
        frame of the agent, see `Egocentric`. Raises TrainingError: it is egocentric, and the layout lacks the fields
        for that.
        """
        self.layout, self.leaky = layout, leaky
        self.frame = Egocentric(layout) if egocentric else None

    def __call__(self, observations: Mapping[str, Array]) -> Observed:
        """Pack the observations of a batch of agents.

        observations: float32 (..., *layout.shapes[key]) by key; the agents of the leading axes are the batch.
        """
        return self._padded(observations) if self.leaky else self._rows(observations)

    def own(self, observations: Mapping[str, Array]) -> Array:
        """Return the numbers that belong to no entity, as observed: float32 (batch, layout.own)."""
        return np.concatenate([observations[key].reshape(-1, width) for key, width in self.layout.alone.items()], 1)

    def _padded(self, observations: Mapping[str, Array]) -> PaddedRows:
        batch = observations[OWN].size // self.layout.shapes[OWN][0]
        packed = np.zeros((batch, self.layout.size), np.float32)
        for key, view in self.layout.views(packed).items():
            view[...] = observations[key].reshape(view.shape)
        return PaddedRows(torch.from_numpy(packed), self.layout)

    def _rows(self, observations: Mapping[str, Array]) -> Rows:
        own = self.own(observations)
        seen = {kind: np.flatnonzero(observations[kind.key + MASK]) for kind in self.layout.kinds}
        agent = np.concatenate([rows // kind.rows for kind, rows in seen.items()] or [np.zeros(0, np.int64)])
        entities, row, column = np.zeros((len(agent), self.layout.columns), np.float32), 0, 0
        for k, (kind, rows) in enumerate(seen.items()):
            here = entities[row : row + len(rows)]
            here[:, column : column + kind.features] = observations[kind.key].reshape(-1, kind.features)[rows]
            here[:, k - len(seen)] = 1
            row, column = row + len(rows), column + kind.features
        if self.frame is not None:
            self.frame(own, entities, agent)
        order, count = np.argsort(agent, kind="stable"), np.bincount(agent, minlength=len(own))
        return Rows(torch.from_numpy(own), torch.from_numpy(entities[order]), torch.from_numpy(count))
