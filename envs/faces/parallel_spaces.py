"""One world, agent by agent and as a whole: the spaces of single agents, and a state that tells of everything."""

from typing import Any

import numpy as np
from gymnasium import spaces

from outlast.components import Body, Health, Item, SelfView, Shape, Side, Zone
from outlast.ecs import Entity, Worlds

from ..arguments import Array, as_array
from ..errors import ActionError
from ..spaces import LARGEST
from ..vector import SurvivalVectorEnv

POSE = ("x", "y", "angle")


def agent_spaces(batch: SurvivalVectorEnv) -> tuple[list[spaces.Dict], list[spaces.MultiDiscrete]]:
    """What each agent alone sees and does: row i of the spaces of a world, in objects of their own."""
    seen: Any = batch.single_observation_space
    boxes = [{key: (box.low[i], box.high[i]) for key, box in seen.items()} for i in range(batch.num_agents)]
    observations = [
        spaces.Dict({key: spaces.Box(low, high, dtype=np.float32) for key, (low, high) in row.items()}) for row in boxes
    ]
    return observations, [spaces.MultiDiscrete(batch.action_sizes) for _ in range(batch.num_agents)]


def agent_action(agent: str, given: Any, sizes: Array) -> Array:
    """The action of one agent as an integer array, each below its size; ActionError."""
    action = as_array(given)
    if action.shape != sizes.shape or action.dtype.kind not in "iu":
        raise ActionError(f"the action of {agent} is {given!r}: {len(sizes)} integers are needed")
    bad = np.flatnonzero((action < 0) | (action >= sizes))
    if bad.size:
        k = int(bad[0])
        raise ActionError(f"action {k} of {agent} is {action[k]}: 0 to {sizes[k] - 1} is allowed")
    return action


class Overview:
    """The state of one world as one float32 vector: for centralised critics, who see all that agents do not.

    In this order, each a block of rows; all but the flags are 0 for what is not there:

    ======= ===================================================================================
    agents  alive (0, 1), then the row `self` of their observation: id, [team], health, x, y, angle, vx, vy, omega
    zone    x, y, radius, next x, next y, next radius; only if the scenario has one
    objects stands (0, 1), x, y, angle, half width, half height, hit points: boxes, and what else has hit points
    items   lies on the ground (0, 1), x, y, and who carries it: 0 nobody, 1 agent_0, 2 agent_1 ...
    ======= ===================================================================================

    Objects and items are in the order of their rows (`Worlds.span` tells which kinds are where).
    """

    def __init__(self, worlds: Worlds) -> None:
        rows = worlds.layout.rows
        self.worlds, self.first = worlds, worlds.span("agent").start
        self.agents, self.items = rows(Side), rows(Item, Body)
        self.objects = np.setdiff1d(rows(Body, Shape, Health), np.concatenate([self.agents, self.items]))
        low, high = [], []
        for count, limits in self._blocks():
            low += [least for least, _ in limits] * count
            high += [most for _, most in limits] * count
        self.space = spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)

    def __call__(self, w: int = 0) -> Array:
        """The vector of world `w`, a new array."""
        parts = [self._agents(w), self._objects(w), self._items(w)]
        if Zone in self.worlds:
            parts.insert(1, self._zone(w))
        return np.concatenate([part.ravel() for part in parts], dtype=np.float32)

    def _blocks(self) -> list[tuple[int, list[tuple[float, float]]]]:
        """(number of rows, (low, high) of each number of a row) of every block."""
        flag, number, carrier = (0.0, 1.0), (-LARGEST, LARGEST), (0.0, float(len(self.agents)))
        features = self.worlds[SelfView].me.shape[-1]
        return [
            (len(self.agents), [flag] + [number] * features),
            (int(Zone in self.worlds), [number] * 6),
            (len(self.objects), [flag] + [number] * 6),
            (len(self.items), [flag] + [number] * 2 + [carrier]),
        ]

    def _agents(self, w: int) -> Array:
        return np.column_stack([self.worlds[Entity].alive[w, self.agents], self.worlds[SelfView].me[w]])

    def _zone(self, w: int) -> Array:
        zone = self.worlds[Zone]
        values = [zone.x, zone.y, zone.radius, zone.next_x, zone.next_y, zone.next_radius]
        return np.concatenate([value[w] for value in values])

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
        """The flag that says who is in the world, and the columns, 0 for those that are not."""
        alive = self.worlds[Entity].alive[w, rows]
        return np.column_stack([alive, *(np.where(alive, column[w, rows], 0) for column in columns)])
