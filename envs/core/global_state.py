"""The state of a world as one vector, for centralised critics."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from outlast.components import Body, Health, Item, SelfView, Shape, Side, Wall, ZoneView
from outlast.components.box import VERTICES
from outlast.ecs import Entity, Worlds
from outlast.ecs.declarations.fields import column_names

from .observations import Scale
from .spaces import bounds
from .validation import Array

POSE = ("x", "y", "angle")


class Block(NamedTuple):
    """Equal rows of the state."""

    names: list[str]  # of their numbers
    ends: Array  # for each number low, high, scale and whether it is in radians, float32 (4, numbers)
    read: Callable[[Any], Array]  # returns the rows of some worlds, (..., rows, numbers of a row)


class GlobalState:
    """The state of one world as one float32 vector, including what no agent sees.

    It consists of these blocks of rows, in this order; for absent entities, all but the flags are 0:

    ======= ===================================================================================
    agents  alive (0, 1), then the row `own` of their observation, with its fields
    zone    the row `zone` of agent_0's observation; only if the scenario has one
    objects stands (0, 1), x, y, angle, half width, half height, hit points: boxes, and other things with hit points
    items   lies on the ground (0, 1), x, y, and its carrier: 0 none, 1 agent_0, 2 agent_1 ...
    walls   stands (0, 1), x, y, angle, half width, half height: blocks inside the room
    bodies  stands (0, 1), x, y, angle: all others, such as a ball, except the four walls around the room
    numbers those that vary (Scenario.vary), in order of names, except words and lists of numbers
    ======= ===================================================================================

    Objects, items, walls and bodies are in the order of their rows (see `Worlds.span` for the rows of kinds).

    Attributes:
        space: The space of the vector.
        names: The names of its numbers: "agent_0.health", "zone.x", "box_3.stands" ...
        scale: Divisors that bring its numbers to about -1 to 1, float32 like the vector.
    """

    def __init__(self, worlds: Worlds, scaled: bool = False) -> None:
        """Prepare it. scaled: Whether to divide by the scales, wrap angles and clip numbers without bounds."""
        rows = worlds.layout.rows
        self.worlds, self.first = worlds, worlds.span("agent").start
        self.agents, self.items = rows(Side), rows(Item, Body)
        self.walls = rows(Wall)
        self.objects = np.setdiff1d(rows(Body, Shape, Health), np.concatenate([self.agents, self.items]))
        around = worlds.layout.spans.get("wall", range(0))
        known = np.concatenate([self.agents, self.items, self.objects, self.walls, around])
        self.bodies = np.setdiff1d(rows(Body), known)
        self.numbers = {name: n for name, n in worlds.layout.varied.items() if n.kind in (bool, int, float)}
        self._blocks = [block for block in self._declared() if block.names]
        low, high, self.scale, radians = np.concatenate([block.ends for block in self._blocks], 1, dtype=np.float32)
        self.names = [name for block in self._blocks for name in block.names]
        self._scale: Scale | None = None
        if scaled:
            self._scale, low, high = Scale(self.scale, np.flatnonzero(radians), np.zeros(0, int)).limited(low, high)
        self.space = spaces.Box(low, high, dtype=np.float32)

    def __call__(self, w: int | slice = 0) -> Array:
        """Return the vector of world `w`, or of some worlds, (worlds, numbers): a new array."""
        parts = [block.read(w) for block in self._blocks]
        state = np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], -1, dtype=np.float32)
        if self._scale is not None:
            self._scale.apply(state)
        return state

    def _declared(self) -> Iterator[Block]:
        """Yield the blocks."""
        worlds, known, fields, flag = self.worlds, bounds(self.worlds), self.worlds.layout.fields, _column(0, 1)
        x, y, angle = np.hsplit(np.vstack([[[-np.inf] * 3, [np.inf] * 3], self._units("own", *POSE)]), 3)
        half, size = _column(scale=VERTICES.scale), ("half_width", "half_height")
        pose, sides = ([getattr(worlds[kind], name) for name in names] for kind, names in ((Body, POSE), (Shape, size)))

        def block(rows: Array, names: Sequence[str], ends: Sequence[Array], read: Callable[[Any], Array]) -> Block:
            entities = [worlds.layout.entity_names[row].replace(" ", "_") for row in rows]
            called = [f"{entity}.{name}" for entity in entities for name in names]
            return Block(called, np.tile(np.hstack(ends), len(rows)), read)

        def standing(rows: Array, names: Sequence[str], ends: Sequence[Array], columns: list[Array]) -> Block:
            return block(rows, ("stands", *names), (flag, *ends), lambda w: self._standing(w, rows, columns))

        def seen(key: str) -> tuple[list[str], Array]:
            return column_names(fields.get(key, {})), np.vstack([*np.stack(known[key])[:, 0], self._units(key)])

        own, ends = seen("own")
        yield block(self.agents, ("alive", *own), (flag, ends), self._agents)
        if ZoneView in worlds:
            zone, ends = seen("zone")  # differs between agents only in fields of mechanics of one's own
            yield Block([f"zone.{name}" for name in zone], ends, lambda w: worlds[ZoneView].zone[w, :1])
        health, points = _column(scale=self._toughest()), worlds[Health].points
        solid = (x, y, angle, half, half)
        yield standing(self.objects, (*POSE, *size, "health"), (*solid, health), [*pose, *sides, points])
        carrier = _column(0, len(self.agents), len(self.agents))
        yield block(self.items, ("lies", "x", "y", "carrier"), (flag, x, y, carrier), self._items)
        yield standing(self.walls, (*POSE, *size), solid, [*pose, *sides])
        yield standing(self.bodies, POSE, (x, y, angle), pose)
        extremes = [[*map(float, number.distribution.extremes())] for number in self.numbers.values()]
        drawn = [_column(low, high, max(abs(low), abs(high), 1e-3)) for low, *_, high in extremes]
        yield Block([f"numbers.{name}" for name in self.numbers], np.hstack(drawn or [flag]), self._numbers)

    def _units(self, key: str, *names: str) -> Array:
        """Return the scale, and whether in radians, (2, columns), of these fields of an observation, or of all."""
        fields = self.worlds.layout.fields[key]
        chosen = [fields[name] for name in names or fields]
        return np.hstack([np.full((2, field.size), [[field.scale], [field.unit == "rad"]]) for field in chosen])

    def _toughest(self) -> float:
        """Return the maximum hit points of an object at the start; 1 without objects."""
        points = self.worlds.layout.prefab_values(Health, "points")
        spans = {name: self.worlds.span(name) for name in points}
        return max([1.0, *(float(np.max(points[name])) for name in points if spans[name].start in self.objects)])

    def _agents(self, w: int | slice) -> Array:
        alive = self.worlds[Entity].alive[w][..., self.agents]
        return np.concatenate([alive[..., None], self.worlds[SelfView].own[w]], -1)

    def _items(self, w: int | slice) -> Array:
        body, holder = self.worlds[Body], self.worlds[Item].holder[w][..., self.items]
        rows = self._standing(w, self.items, [body.x, body.y])
        return np.concatenate([rows, np.where(holder >= 0, holder - self.first + 1, 0)[..., None]], -1)

    def _numbers(self, w: int | slice) -> Array:
        known = self.worlds.numbers()
        return np.stack([known[name][w] for name in self.numbers], -1)[..., None, :]

    def _standing(self, w: int | slice, rows: Array, columns: list[Array]) -> Array:
        """Return whether each row is in the world, followed by its columns, which are 0 if it is not."""
        alive = self.worlds[Entity].alive[w][..., rows]
        return np.stack([alive, *(np.where(alive, column[w][..., rows], 0) for column in columns)], -1)


def _column(low: float = -np.inf, high: float = np.inf, scale: float = 1.0) -> Array:
    return np.array([[low], [high], [scale], [False]], np.float32)
