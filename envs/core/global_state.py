"""The state of a whole world as one vector, for centralised critics."""

from collections.abc import Iterator

import numpy as np
from gymnasium import spaces

from outlast.components import Body, Health, Item, SelfView, Shape, Side, Wall, ZoneView
from outlast.components.box import VERTICES
from outlast.ecs import Distribution, Entity, Worlds
from outlast.ecs.declarations.fields import column_names

from .scaling import Scale
from .spaces import bounds
from .validation import Array

POSE = ("x", "y", "angle")


class GlobalState:
    """The state of one world as one float32 vector, including what no agent sees.

    It consists of these blocks of rows, in this order; for entities that are not there, all but the flags are 0:

    ======= ===================================================================================
    agents  alive (0, 1), then the row `own` of their observation, with its fields
    zone    the row `zone` of agent_0's observation, likewise; only if the scenario has one
    objects stands (0, 1), x, y, angle, half width, half height, hit points: boxes, and other things with hit points
    items   lies on the ground (0, 1), x, y, and its carrier: 0 none, 1 agent_0, 2 agent_1 ...
    walls   stands (0, 1), x, y, angle, half width, half height: blocks inside the room
    bodies  stands (0, 1), x, y, angle: all others, such as a ball, except the four walls around the room
    numbers those that vary (Scenario.vary), in order of names, except words and lists of numbers
    ======= ===================================================================================

    Objects, items, walls and bodies are in the order of their rows (`Worlds.span` says which kinds are where).

    Attributes:
        space: The space of the vector.
        names: The names of its numbers: "agent_0.health", "zone.x", "box_3.stands" ...
        scale: What to divide its numbers by to get about -1 to 1, float32 like the vector.
    """

    def __init__(self, worlds: Worlds, scaled: bool = False) -> None:
        """Prepare it. scaled: divide by the scales, wrap angles and clip numbers without bounds, like scaling.Scale."""
        rows = worlds.layout.rows
        self.worlds, self.first = worlds, worlds.span("agent").start
        self.agents, self.items = rows(Side), rows(Item, Body)
        self.walls = rows(Wall)
        self.objects = np.setdiff1d(rows(Body, Shape, Health), np.concatenate([self.agents, self.items]))
        around = worlds.layout.spans.get("wall", range(0))
        known = np.concatenate([self.agents, self.items, self.objects, self.walls, around])
        self.bodies = np.setdiff1d(rows(Body), known)
        self.numbers = {name: n for name, n in worlds.layout.varied.items() if n.kind in (bool, int, float)}
        blocks = [np.tile(block, count) for count, block in self._blocks()]
        low, high, self.scale, radians = np.concatenate(blocks, 1, dtype=np.float32)
        self.names = list(self._names())
        self._scale: Scale | None = None
        if scaled:
            self._scale, low, high = Scale(self.scale, np.flatnonzero(radians), np.zeros(0, int)).limited(low, high)
        self.space = spaces.Box(low, high, dtype=np.float32)

    def __call__(self, w: int | slice = 0) -> Array:
        """Return the vector of world `w`, or of some worlds, (worlds, numbers): a new array."""
        parts = [self._agents(w), self._objects(w), self._items(w), self._walls(w)]
        parts += [self._bodies(w), self._numbers(w)]
        if ZoneView in self.worlds:
            parts.insert(1, self.worlds[ZoneView].zone[w, :1])  # differs only in fields of mechanics of one's own
        flat = [part.reshape(*part.shape[:-2], -1) for part in parts if part.size]
        state = np.concatenate(flat, -1, dtype=np.float32)
        if self._scale is not None:
            self._scale.apply(state)
        return state

    def _blocks(self) -> list[tuple[int, Array]]:
        """Return, for every block, how many rows it has, and a row's low, high, scale and whether it is in radians.

        Those of a row are float32 (4, numbers).
        """
        known, flag, carrier = bounds(self.worlds), _column(0, 1), _column(0, len(self.agents), len(self.agents))
        place = np.hsplit(np.vstack([[[-np.inf] * 3, [np.inf] * 3], self._units("own", *POSE)]), 3)
        half, health = _column(scale=VERTICES.scale), _column(scale=self._toughest())
        own = np.vstack([*np.stack(known["own"])[:, 0], self._units("own")])
        zone = np.vstack([*np.stack(known["zone"])[:, 0], self._units("zone")]) if "zone" in known else None
        return [
            (len(self.agents), np.hstack([flag, own])),
            *([] if zone is None else [(1, zone)]),
            (len(self.objects), np.hstack([flag, *place, half, half, health])),
            (len(self.items), np.hstack([flag, *place[:2], carrier])),
            (len(self.walls), np.hstack([flag, *place, half, half])),
            (len(self.bodies), np.hstack([flag, *place])),
            *((1, _column(*_extent(number.distribution))) for number in self.numbers.values()),
        ]

    def _names(self) -> Iterator[str]:
        """Yield the names of the numbers, in the order of the blocks."""
        fields, half = self.worlds.layout.fields, ("half_width", "half_height")
        own, zone = (column_names(fields.get(key, {})) for key in ("own", "zone"))
        blocks = [
            (self.agents, ("alive", *own)),
            (self.objects, ("stands", *POSE, *half, "health")),
            (self.items, ("lies", "x", "y", "carrier")),
            (self.walls, ("stands", *POSE, *half)),
            (self.bodies, ("stands", *POSE)),
        ]
        entities = [[f"{self._called(row)}.{name}" for row in rows for name in names] for rows, names in blocks]
        if ZoneView in self.worlds:
            entities.insert(1, [f"zone.{name}" for name in zone])
        for names in (*entities, [f"numbers.{name}" for name in self.numbers]):
            yield from names

    def _called(self, row: int) -> str:
        """Return the name of an entity, from its archetype and its number in that: "box_3"."""
        return next(f"{name}_{row - span.start}" for name, span in self.worlds.layout.spans.items() if row in span)

    def _units(self, key: str, *names: str) -> Array:
        """Return scale and whether in radians, (2, columns), of these fields of an observation, or of all of it."""
        fields = self.worlds.layout.fields[key]
        chosen = [fields[name] for name in names or fields]
        return np.hstack([np.full((2, field.size), [[field.scale], [field.unit == "rad"]]) for field in chosen])

    def _toughest(self) -> float:
        """Return the most hit points that any object has at the start; 1 if there are no objects."""
        points = self.worlds.layout.prefab_values(Health, "points")
        spans = {name: self.worlds.span(name) for name in points}
        return max([1.0, *(float(np.max(points[name])) for name in points if spans[name].start in self.objects)])

    def _agents(self, w: int | slice) -> Array:
        alive = self.worlds[Entity].alive[w][..., self.agents]
        return np.concatenate([alive[..., None], self.worlds[SelfView].own[w]], -1)

    def _objects(self, w: int | slice) -> Array:
        return self._standing(w, self.objects, [*self._rectangles(), self.worlds[Health].points])

    def _items(self, w: int | slice) -> Array:
        body = self.worlds[Body]
        rows = self._standing(w, self.items, [body.x, body.y])
        if not len(self.items):  # then the component Item may be missing, too
            return np.zeros((*rows.shape[:-1], 4))
        holder = self.worlds[Item].holder[w][..., self.items]
        return np.concatenate([rows, np.where(holder >= 0, holder - self.first + 1, 0)[..., None]], -1)

    def _walls(self, w: int | slice) -> Array:
        return self._standing(w, self.walls, self._rectangles())

    def _bodies(self, w: int | slice) -> Array:
        return self._standing(w, self.bodies, [getattr(self.worlds[Body], name) for name in POSE])

    def _rectangles(self) -> list[Array]:
        """Return pose and half sides of all bodies, (worlds, rows) each."""
        body, shape = self.worlds[Body], self.worlds[Shape]
        return [getattr(body, name) for name in POSE] + [shape.half_width, shape.half_height]

    def _numbers(self, w: int | slice) -> Array:
        """Return the varied numbers as a block of one row: (..., 1, numbers)."""
        if not self.numbers:
            return np.zeros(0)
        known = self.worlds.numbers()
        return np.stack([known[name][w] for name in self.numbers], -1)[..., None, :]

    def _standing(self, w: int | slice, rows: Array, columns: list[Array]) -> Array:
        """Return whether each row is in the world, followed by its columns, which are 0 if it is not."""
        alive = self.worlds[Entity].alive[w][..., rows]
        return np.stack([alive, *(np.where(alive, column[w][..., rows], 0) for column in columns)], -1)


def _extent(distribution: Distribution) -> tuple[float, float, float]:
    """Return the lowest and highest value of a distribution, and the divisor that scales them to -1 to 1."""
    low, *_, high = map(float, distribution.extremes())
    return low, high, max(abs(low), abs(high), 1e-3)


def _column(low: float = -np.inf, high: float = np.inf, scale: float = 1.0) -> Array:
    return np.array([[low], [high], [scale], [False]], np.float32)
