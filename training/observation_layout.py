"""How an agent's observation lies in one row of numbers, ready for the networks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
MASK = "_mask"
OWN = "own"  # what an agent observes of itself
RENAMED_KEYS = {"self": OWN}  # observation keys of older files: what they are called now; masks go with them
SPEED, SPIN, SIDE = 10.0, 5.0, 2.0  # metres a second, radians a second, metres of a box: what is seldom exceeded


def current_key(key: str) -> str:
    """What an observation key of an older file is called now."""
    stem = key.removesuffix(MASK)
    return RENAMED_KEYS.get(stem, stem) + key[len(stem) :]


@dataclass(frozen=True)
class EntityKind:
    """A kind of entity: its key, its rows in the observation of one agent, and the numbers in each row."""

    key: str
    rows: int
    features: int


class ObservationLayout:
    """The packed row of one agent: its own numbers, the masks, the rows of all kinds of entities.

    own: numbers that belong to no entity, by key in `alone`, the agent itself first. rows: entities, kind after kind.
    features: numbers of the widest kind, which every row of a narrower one is filled up to with zeros. size: own + rows
    + rows * features.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """shapes: of one agent's observations by current key; a kind is a key with a companion key_mask."""
        keys = sorted((key for key in shapes if not key.endswith(MASK)), key=lambda key: (key != OWN, key))
        self.alone = {key: math.prod(shapes[key]) for key in keys if key + MASK not in shapes}
        self.kinds = [EntityKind(key, *shapes[key]) for key in keys if key + MASK in shapes]
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
        """The index of the kind of each row."""
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


def layout_of(env: Any) -> ObservationLayout:
    """The layout of a SurvivalVectorEnv's observations."""
    return ObservationLayout({key: array.shape[2:] for key, array in env.observe().items()})


def scales(layout: ObservationLayout, numbers: Mapping[str, Any]) -> tuple[Array, Array]:
    """Factors that bring every number to about -1 to 1: float32 (own,), and (numbers of all kinds,).

    numbers: the scenario's.
    """
    known = {current_key(key): bounds for key, bounds in _bounds(numbers).items()}
    own = [_filled(known.get(key, ()), width) for key, width in layout.alone.items()]
    kinds = [_filled(known.get(kind.key, ()), kind.features) for kind in layout.kinds]
    return np.concatenate([*own, []]).astype(np.float32), np.concatenate([*kinds, []]).astype(np.float32)


def _bounds(numbers: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Bounds of the last numbers of each row, by first key; those before are ids and sides, which stay as they are."""
    half = numbers["room_size"] / 2 if "room_size" in numbers else 1.0
    agent = (numbers["agents_health"], half, half, math.pi, SPEED, SPEED, SPIN)
    corners = (SIDE,) * 8
    return {
        OWN: agent,
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
