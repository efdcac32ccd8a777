"""How an agent's observation lies in one row of numbers, ready for the networks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
MASK = "_mask"
SPEED, SPIN, SIDE = 10.0, 5.0, 2.0  # metres a second, radians a second, metres of a box: what is seldom exceeded


@dataclass(frozen=True)
class Kind:
    """A kind of entity: its key, its rows in the observation of one agent, and the numbers in each row."""

    key: str
    rows: int
    features: int


class Layout:
    """The packed row of one agent: what it is told of itself and the zone, the masks, the rows of all kinds.

    own: numbers that belong to no entity, "self" first. rows: entities, kind after kind. features: numbers of the
    widest kind, which every row of a narrower one is filled up to with zeros. size: own + rows + rows * features.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """shapes: of one agent's observations by key; a kind is a key with a companion key_mask."""
        alone = [key for key in shapes if not key.endswith(MASK) and key + MASK not in shapes]
        self.alone = {key: math.prod(shapes[key]) for key in sorted(alone, key=lambda key: (key != "self", key))}
        self.kinds = [Kind(key, *shapes[key]) for key in sorted(shapes) if key + MASK in shapes]
        self.shapes = dict(shapes)
        self.own, self.rows = sum(self.alone.values()), sum(kind.rows for kind in self.kinds)
        self.features = max((kind.features for kind in self.kinds), default=0)
        self.size = self.own + self.rows * (1 + self.features)

    def views(self, packed: Array) -> dict[str, Array]:
        """Views of a packed array (worlds, agents, size) by key, to be filled by SurvivalVectorEnv.observe(out=)."""
        views, start = {}, 0
        for key, width in self.alone.items():
            views[key] = packed[..., start : start + width]
            start += width
        masks = packed[..., self.own : self.own + self.rows]
        cells = packed[..., self.own + self.rows :].reshape(*packed.shape[:-1], self.rows, self.features)
        start = 0
        for kind in self.kinds:
            there = slice(start, start + kind.rows)
            views[kind.key], views[kind.key + MASK] = cells[..., there, : kind.features], masks[..., there]
            start += kind.rows
        return views

    def kind_of_row(self) -> list[int]:
        """The number of its kind for each row."""
        return [k for k, kind in enumerate(self.kinds) for _ in range(kind.rows)]

    def cells(self) -> list[int]:
        """For each cell of a row of each kind, ((kinds + 1) * features), which of the numbers of all kinds it holds.

        Cells that are always zero hold number 0; those of the last kind, which has no numbers, all are.
        """
        cells, start = [], 0
        for kind in self.kinds:
            cells += list(range(start, start + kind.features)) + [0] * (self.features - kind.features)
            start += kind.features
        return cells + [0] * self.features


def layout_of(core: Any) -> Layout:
    """The layout of a SurvivalVectorEnv's observations."""
    return Layout({key: array.shape[2:] for key, array in core.observe().items()})


def scales(layout: Layout, numbers: Mapping[str, Any]) -> tuple[Array, Array]:
    """What brings every number to about -1 to 1: float32 (own,), and (numbers of all kinds,).

    numbers: the scenario's.
    """
    known = _known(numbers)
    own = [_filled(known.get(key, ()), width) for key, width in layout.alone.items()]
    kinds = [_filled(known.get(kind.key, ()), kind.features) for kind in layout.kinds]
    return np.concatenate([*own, []]).astype(np.float32), np.concatenate([*kinds, []]).astype(np.float32)


def _known(numbers: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Bounds of the last numbers of each row; those before them are ids and sides, which are left as they are."""
    half = numbers["room_size"] / 2 if "room_size" in numbers else 1.0
    agent = (numbers["agents_health"], half, half, math.pi, SPEED, SPEED, SPIN)
    corners = (SIDE,) * 8
    return {
        "self": agent,
        "others": agent,
        "zone": (half,) * 6,
        "heals": (half, half),
        "heal_slot": (numbers.get("heals_amount") or 1.0,),
        "boxes": (*corners, half, half, math.pi),
        "box_items": (*corners, half, half),
        "box_slot": corners,
    }


def _filled(bounds: tuple[float, ...], width: int) -> Array:
    """One over the bounds, with ones before them."""
    return 1 / np.array([1.0] * (width - len(bounds)) + list(bounds))
