"""Turns the observations of worlds into the rows that networks take."""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from outlast.ecs import CompiledUnits
from outlast.ecs.kernels.jit import compiled, kernel, loader, storer
from outlast.envs.core.visible_rows import START, VisibleRows

from ..base.observation_layout import OWN, ObservationLayout
from .egocentric import ANGLE, turn, turns
from .rows import Observed, PaddedRows, Rows

Array = np.ndarray[Any, Any]
KIND = 6  # numbers of a kind: addresses of its list, of starts and of turns; columns, the first one here, turns
word, read, write, write_word = loader("int64"), loader("float32"), storer("float32"), storer("int64")


@kernel
def pack(
    agents: int, own: int, turned: int, own_columns: int, angle: int, own_turns: int, own_count: int, kinds: int,
    lists: int, entities: int, columns: int, count: int,
) -> int:  # fmt: skip
    """Join the lists of all kinds to one of all entities, agent after agent. Most arguments are addresses.

    Args:
        agents: How many observe.
        own: float32 (agents, own_columns), their own numbers.
        turned: The same, written: turned.
        own_columns: How many these are.
        angle: Column of an agent's angle.
        own_turns: See `turns`.
        own_count: How many turns.
        kinds: How many kinds there are.
        lists: int64 (kinds, KIND).
        entities: float32 (n, columns), written.
        columns: Of an entity: those of all kinds, and one for each kind.
        count: int64 (agents,), written: how many entities are each agent's.
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


@functools.cache
def _packing() -> Any:
    """The kernel, for Python to call."""
    if not compiled():
        return pack
    units = CompiledUnits([], {"pack": pack}, {})
    units.load()
    return units.function("pack")


class Packer:
    """Packs observations, by key and kind, in the form that the networks of a preset take."""

    def __init__(self, layout: ObservationLayout, *, leaky: bool, egocentric: bool) -> None:
        """Make a packer for the networks of a preset.

        leaky: Whether the rows of hidden entities are packed, too. egocentric: Whether what is seen is brought into the
        frame of the agent, see `turns`. Raises TrainingError: it is egocentric, and the layout lacks the fields for
        that.
        """
        self.layout, self.leaky = layout, leaky
        none: list[Array] = [np.zeros((0, 0), np.int64)] * (1 + len(layout.kinds))
        self._turns = turns(layout) if egocentric else none
        self._angle = layout.field_columns()[OWN][ANGLE] if egocentric else 0

    def __call__(self, observations: Mapping[str, Array]) -> Observed:
        """Pack the observations of a batch of agents.

        observations: float32 (..., *layout.shapes[key]) by key; the agents of the leading axes are the batch. Or with
        lists of rows, as of make_vec(observations="rows").
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
        if any(kind.key + START not in observations for kind in self.layout.kinds):
            batch = {key: observations[key].reshape(1, len(own), *shape) for key, shape in self.layout.shapes.items()}
            observations = VisibleRows(batch)()
        lists, kept, first, size = [], list[Array](), 0, 0  # kept: what lies at the addresses in `lists`
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
        _packing()(
            len(own), own.ctypes.data, turned.ctypes.data, own.shape[1], self._angle, self._turns[0].ctypes.data,
            len(self._turns[0]), len(lists), table.ctypes.data, entities.ctypes.data, columns, count.ctypes.data,
        )  # fmt: skip
        return Rows(torch.from_numpy(turned), torch.from_numpy(entities), torch.from_numpy(count))
