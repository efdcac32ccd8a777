"""The layout of an agent's observation in one row of numbers, ready for the networks."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs import Fields

from .errors import TrainingError

Array = np.ndarray[Any, Any]
MASK = "_mask"
OWN = "own"  # key of an agent's observation of itself
FieldTable = Mapping[str, Mapping[str, Sequence[float]]]  # size and scale by key and name, in order of columns


@dataclass(frozen=True)
class EntityKind:
    """A kind of entity: its key, its rows and its numbers per row in one agent's observation."""

    key: str
    rows: int
    features: int


class ObservationLayout:
    """The packed row of one agent: its own numbers, the masks, the rows of all kinds of entities.

    Attributes:
        alone: Numbers of each key that belongs to no entity, the agent itself first.
        rows: Number of entities, kind after kind.
        features: Numbers of the widest kind; rows of narrower kinds are padded with zeros.
        size: Length of the packed row: own + rows + rows * features.
        columns: Columns of an entity in Rows: the numbers of all kinds, and one more for each kind.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]], fields: "FieldTable | None" = None) -> None:
        """shapes: Of an agent's observations by key; a key with a companion key_mask is a kind. fields: Of the rows."""
        self.fields = fields or {}
        keys = sorted((key for key in shapes if not key.endswith(MASK)), key=lambda key: (key != OWN, key))
        self.alone = {key: math.prod(shapes[key]) for key in keys if key + MASK not in shapes}
        self.kinds = [EntityKind(key, *shapes[key]) for key in keys if key + MASK in shapes]
        self.shapes = dict(shapes)
        self.own, self.rows = sum(self.alone.values()), sum(kind.rows for kind in self.kinds)
        self.features = max((kind.features for kind in self.kinds), default=0)
        self.size = self.own + self.rows * (1 + self.features)
        self.columns = sum(kind.features for kind in self.kinds) + len(self.kinds)

    def field_columns(self) -> dict[str, dict[str, int]]:
        """Return the first column of each field by key and name: of an agent's own numbers, or of an entity in Rows."""
        found, starts = dict[str, dict[str, int]](), dict[str, int]()
        for widths in (self.alone, {kind.key: kind.features for kind in self.kinds}):
            start = 0
            for key, width in widths.items():
                starts[key], start = start, start + width
        for key, column in starts.items():
            found[key] = {}
            for name, (size, _) in self.fields.get(key, {}).items():
                found[key][name] = column
                column += int(size)
        return found

    def own_views(self, own: Array) -> dict[str, Array]:
        """Return views of the numbers that belong to no entity, by key. own: (..., own or more)."""
        parts = np.split(own, np.cumsum([*self.alone.values()]), -1)
        return dict(zip(self.alone, parts, strict=False))

    def views(self, packed: Array) -> dict[str, Array]:
        """Return views of a packed array (..., size), by key."""
        views = self.own_views(packed)
        masks = packed[..., self.own : self.own + self.rows]
        cells = packed[..., self.own + self.rows :].reshape(*packed.shape[:-1], self.rows, self.features)
        start = 0
        for kind in self.kinds:
            there = slice(start, start + kind.rows)
            views[kind.key], views[kind.key + MASK] = cells[..., there, : kind.features], masks[..., there]
            start += kind.rows
        return views


def layout_of(env: Any) -> ObservationLayout:
    """Return the layout of a SurvivalVectorEnv's observations."""
    return ObservationLayout(
        {key: box.shape[1:] for key, box in env.single_observation_space.items()}, field_table(env.fields)
    )


def field_table(fields: Fields) -> FieldTable:
    """Return the size and scale of the fields by key and name, as stored in checkpoints."""
    return {
        key: {name: [field.size, float(field.scale)] for name, field in named.items()} for key, named in fields.items()
    }


def scales(layout: ObservationLayout, table: FieldTable) -> tuple[Array, Array]:
    """Return factors of inputs to about -1 to 1: float32 (own,), (numbers of all kinds,). Raises TrainingError."""

    def factors(key: str, width: int) -> Array:
        if key not in table:
            return np.ones(width)
        fields = table[key].values()
        row = np.repeat([1 / scale for _, scale in fields], [int(size) for size, _ in fields])
        if len(row) != layout.shapes[key][-1]:
            wrong = f"rows of {key} have {layout.shapes[key][-1]} numbers, but its fields {len(row)}"
            raise TrainingError(f"run.json has observations that do not fit each other: {wrong}")
        return np.tile(row, width // len(row))

    own = [factors(key, width) for key, width in layout.alone.items()]
    kinds = [factors(kind.key, kind.features) for kind in layout.kinds]
    return np.concatenate([*own, []]).astype(np.float32), np.concatenate([*kinds, []]).astype(np.float32)
