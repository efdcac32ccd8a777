"""Conversion of observations of worlds into the rows that networks take, perhaps in the agents' own frames.

An agent's actions are in its own frame (ahead, to the left, turn), but observations are in the room's, with angles that
grow with every turn. A network would have to learn to subtract and to rotate before it could walk towards anything.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch

from outlast.ecs.kernels.jit import kernel, loader, storer
from outlast.envs.core.visible_rows import START, VisibleRows, called

from ..base.errors import TrainingError
from ..base.observation_layout import OWN, ObservationLayout
from ..base.presets import Form, Preset
from .rows import Observed, PaddedRows, Rows

Array = np.ndarray[Any, Any]
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


def turns(layout: ObservationLayout) -> list[Array]:
    """Return the turns that bring rows into the frame of the observing agent: it is at the origin and looks along x.

    Positions become relative to the agent's position, velocities to its velocity, angles of others to its own. All
    angles are brought into the range of -pi to pi. Returns int64 (turns, TURN) for an agent's own numbers, and then
    for each kind. Raises TrainingError if the layout lacks the agent's own position, velocity or angle.
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
    """Turn a row in place. row, me: Addresses of float32 numbers, those of the row and the agent's own as observed.

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


def packers_of(layout: ObservationLayout, presets: Iterable[Preset]) -> dict[Form, "Packer"]:
    """Return a packer for each form that networks of these presets take. Raises TrainingError, see Packer."""
    return {form: Packer(layout, form) for form in dict.fromkeys(each.form for each in presets)}


class Packer:
    """A packer of observations, by key and kind, in the form for the networks of a preset."""

    def __init__(self, layout: ObservationLayout, form: Form) -> None:
        """Make a packer for the networks of presets of that form.

        If it is leaky, the rows of hidden entities are packed, too; if egocentric, what is seen is brought into the
        frame of the agent, see `turns`. Raises TrainingError: it is egocentric, and the layout lacks the fields for
        that.
        """
        self.layout, (self.leaky, egocentric) = layout, form
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
