"""The state of a whole world as one vector, for centralised critics."""

import numpy as np
from gymnasium import spaces

from outlast.components import Body, Health, Item, SelfView, Shape, Side, ZoneView
from outlast.ecs import Entity, Worlds

from ..core.spaces import bounds
from ..core.validation import Array

POSE = ("x", "y", "angle")


class GlobalState:
    """The state of one world as one float32 vector, with what no agent sees.

    In this order, each a block of rows; all but the flags are 0 for what is not there:

    ======= ===================================================================================
    agents  alive (0, 1), then the row `own` of their observation, with the fields of that
    zone    the row `zone` of their observation, likewise; only if the scenario has one
    objects stands (0, 1), x, y, angle, half width, half height, hit points: boxes, and what else has hit points
    items   lies on the ground (0, 1), x, y, and its carrier: 0 none, 1 agent_0, 2 agent_1 ...
    ======= ===================================================================================

    Objects and items are in the order of their rows (`Worlds.span` says which kinds are where).
    """

    def __init__(self, worlds: Worlds) -> None:
        rows = worlds.layout.rows
        self.worlds, self.first = worlds, worlds.span("agent").start
        self.agents, self.items = rows(Side), rows(Item, Body)
        self.objects = np.setdiff1d(rows(Body, Shape, Health), np.concatenate([self.agents, self.items]))
        low, high = np.concatenate([np.tile(ends, count) for count, ends in self._blocks()], 1)
        self.space = spaces.Box(low, high, dtype=np.float32)

    def __call__(self, w: int = 0) -> Array:
        """The vector of world `w`, a new array."""
        parts = [self._agents(w), self._objects(w), self._items(w)]
        if ZoneView in self.worlds:
            parts.insert(1, self.worlds[ZoneView].zone[w, 0])  # the same for all agents
        return np.concatenate([part.ravel() for part in parts], dtype=np.float32)

    def _blocks(self) -> list[tuple[int, Array]]:
        """(number of rows, low and high of the numbers of a row, float32 (2, numbers)) of every block."""
        known, flag, carrier = bounds(self.worlds), _ends(1, 0, 1), _ends(1, 0, len(self.agents))
        zone = [(1, np.stack(known["zone"])[:, 0])] if ZoneView in self.worlds else []
        return [
            (len(self.agents), np.hstack([flag, np.stack(known["own"])[:, 0]])),
            *zone,
            (len(self.objects), np.hstack([flag, _ends(6)])),
            (len(self.items), np.hstack([flag, _ends(2), carrier])),
        ]

    def _agents(self, w: int) -> Array:
        return np.column_stack([self.worlds[Entity].alive[w, self.agents], self.worlds[SelfView].own[w]])

    def _objects(self, w: int) -> Array:
        body, shape = self.worlds[Body], self.worlds[Shape]
        columns = [getattr(body, name) for name in POSE] + [shape.half_width, shape.half_height]
        return self._standing(w, self.objects, [*columns, self.worlds[Health].points])

    def _items(self, w: int) -> Array:
        body = self.worlds[Body]
        rows = self._standing(w, self.items, [body.x, body.y])
        holder = self.worlds[Item].holder[w, self.items] if len(self.items) else np.zeros(0, np.int32)
        return np.column_stack([rows, np.where(holder >= 0, holder - self.first + 1, 0)])

    def _standing(self, w: int, rows: Array, columns: list[Array]) -> Array:
        """Whether each row is in the world, and its columns, 0 if it is not."""
        alive = self.worlds[Entity].alive[w, rows]
        return np.column_stack([alive, *(np.where(alive, column[w, rows], 0) for column in columns)])


def _ends(count: int, low: float = -np.inf, high: float = np.inf) -> Array:
    return np.array([[low] * count, [high] * count], np.float32)
