"""The scene: one world in the form that layers read."""

import dataclasses
import functools
import math
from typing import Any, TypeVar

from outlast.components import Body, Box, BoxItem, Filter, Floor, Guard, Heal, Polygon, Shape, Side, Sides, Solid
from outlast.components.agent import side_names
from outlast.components.look import NOTHING, HasLooks, Look
from outlast.ecs import Clock, Component, Entity, Event, MemoryLayout, Module, Worlds
from outlast.ecs.memory.numbers import Varied

from .style import KINDS, SIZES, Color

M = TypeVar("M", bound=Module)

THINNEST = 1e-9  # metres: half the width of a rectangle without any
# entities with these are drawn by outlast's own layers, or not at all if those are not shown
KNOWN = (Side, Box, BoxItem, Heal)


class Scene:
    """World `w` in plain Python: scene[C] is the table of component C, its columns as lists of Python numbers.

    The lists are copies, made on first use, so a layer cannot change the world; and reading numbers from lists is ten
    times faster than from arrays. sides: distances from the origin to the edges of the room along x and y, metres.
    room: the larger of them. half: distance to the edge of the picture, which is a little larger.
    """

    def __init__(self, worlds: Worlds, w: int) -> None:
        self.worlds, self.w = worlds, w
        self._tables: dict[type[Component], Any] = {}
        self._prefabs: dict[type[Component], Any] = {}
        self.body, self.shape, self._alive = self[Body], self[Shape], self[Entity].alive
        self.sides = self._reach()
        self.room = max(self.sides)
        self.half = SIZES.margin * self.room
        self.looks = _looks(worlds.layout)
        self.shown: set[type[Component]] = set()  # components whose entities the picture's layers draw, see Layer.shows

    def __getitem__(self, component: type[Component]) -> Any:
        if component not in self._tables:
            columns = (column[self.w].tolist() for column in self.worlds[component])
            self._tables[component] = component.Table(*columns)
        return self._tables[component]

    def __contains__(self, kind: type[Component] | type[Module]) -> bool:
        """Return whether this scenario has the component, or the mechanic."""
        if issubclass(kind, Component):
            return kind in self.worlds
        return any(isinstance(module, kind) for module in self.worlds.layout.modules)

    def events(self, kind: type[Event]) -> list[Any]:
        """Return what happened in the last tick: the columns of each event by name (event.agent), in order."""
        if kind not in self:
            return []
        columns = self[kind]
        return [kind.Table(*entry, count=1) for entry in zip(*columns[:-1])][: columns.count[0]]

    def living(self, *components: type[Component]) -> list[int]:
        """Return the rows of entities that have all of these components and are in the world now."""
        return [e for e in _rows(self.worlds.layout, components) if self._alive[e]]

    def agents(self) -> list[tuple[int, int]]:
        """Return number and row of each agent that is in the world now."""
        return [(i, e) for i, e in enumerate(self.rows(Side)) if self._alive[e]]

    def rows(self, *components: type[Component]) -> tuple[int, ...]:
        """Return the rows of all entities with all of these components, in the world or not; agents in order of id."""
        return _rows(self.worlds.layout, components)

    def looked_up(self, e: int, what: str) -> float:
        """Return the number in the column that the look of row `e` names, as "tint"; -1 without one."""
        column = getattr(self.looks.get(e), what, None)
        if column is None or e not in self.rows(column.owner):
            return NOTHING
        return float(getattr(self[column.owner], column.name)[e])

    def corners(self, e: int) -> list[tuple[float, float]]:
        """Return the corners of a polygon, metres, in its own frame, counter-clockwise; none for other shapes."""
        if Polygon not in self.worlds or not (count := self[Polygon].corners[e]):
            return []
        return list(zip(self[Polygon].x[e], self[Polygon].y[e], strict=True))[:count]

    def outline(self, e: int, grow: float = 0, least: float = THINNEST) -> list[tuple[float, float]]:
        """Return the corners of a polygon or a rectangle where it is, counter-clockwise.

        Each side is moved outwards by `grow` metres; a rectangle remains at least twice `least` wide.
        """
        if corners := self.corners(e):
            placed, sides = [], _sides(corners)
            for k, (a, b) in enumerate(corners):
                (ux, uy, _), (vx, vy, _) = sides[k - 1], sides[k]
                far = grow / (1 + ux * vx + uy * vy)
                placed.append((a + far * (ux + vx), b + far * (uy + vy)))
        else:
            a, b = (max(least, halves[e] + grow) for halves in (self.shape.half_width, self.shape.half_height))
            placed = [(-a, -b), (a, -b), (a, b), (-a, b)]
        x, y, cosine, sine = self.body.x[e], self.body.y[e], self.body.cosine[e], self.body.sine[e]
        return [(x + a * cosine - b * sine, y + a * sine + b * cosine) for a, b in placed]

    def least_half(self, e: int) -> float:
        """Return how far the middle of a body is from its nearest side, metres."""
        if corners := self.corners(e):
            return min(far for *_, far in _sides(corners))
        return float(self.shape.radius[e] or min(self.shape.half_width[e], self.shape.half_height[e]))

    def side_name(self, side: int) -> str:
        """Return a side's name (see side_names), or its number if a mechanic of the user's makes the teams."""
        layout, teams = self.worlds.layout, Sides in self and self[Sides].teams[0]
        names = side_names(layout) if layout.groups() or not teams else ()
        return names[side] if side < len(names) else f"{'team' if teams else 'agent'} {side}"

    def prefab(self, component: type[Component]) -> Any:
        """Return the table as it is at the start of an episode."""
        if component not in self._prefabs:
            columns = self.worlds.layout.columns(self.worlds.initial_image(self.w)[None], component)
            self._prefabs[component] = component.Table(*(column[0].tolist() for column in columns))
        return self._prefabs[component]

    def mechanic(self, kind: type[M], agent: int | None = None) -> M:
        """Return the mechanic of this class with the numbers of this world, or of the agent in a row of it.

        KeyError if this scenario lacks it.
        """
        for k, module in enumerate(self.worlds.modules):
            if isinstance(module, kind):
                numbers = self._numbers(k, agent)
                return module.replace(**numbers) if numbers else module
        raise KeyError(f"this scenario has no mechanic {kind.__name__}")

    def _numbers(self, k: int, agent: int | None) -> dict[str, Any]:
        """Return the numbers of the k-th mechanic that this world, or an agent in a row of it, has for itself."""
        layout, module, found = self.worlds.layout, self.worlds.modules[k], dict[str, Any]()
        for number in layout.varied.values():
            if number.module == k:
                words = self.worlds[Varied].words[self.w, :, None].copy()
                value = number.decode(words, module)[0].tolist()
                found[number.field] = tuple(value) if isinstance(value, list) else value
        if agent is not None and self[Clock].episode[0]:  # before a reset, agents have no roles
            i, own = self.rows(Side).index(agent), [n for n in layout.per_agent.values() if n.module == k]
            found |= {number.field: self.worlds.agent_values(number)[self.w, i].item() for number in own}
        for item in dataclasses.fields(module):
            # rounding to float32 may have moved it out of its range
            if isinstance(value := found.get(item.name), float):
                low, high = item.metadata.get("low", -math.inf), item.metadata.get("high", math.inf)
                found[item.name] = min(max(value, low), high)
        return found

    def _reach(self) -> tuple[float, float]:
        if Floor in self.worlds:
            sides = self[Floor].size
            return sides[0] / 2, sides[-1] / 2
        x, y, bound = self.body.x, self.body.y, self.shape.bound
        ends = [max(abs(x[e]), abs(y[e])) + bound[e] for e in self.living(Body, Shape)]
        reach: float = max([1.0, *filter(math.isfinite, ends)])
        return reach, reach


def _sides(corners: list[tuple[float, float]]) -> list[tuple[float, float, float]]:
    """Return the outer normal of the side from each corner to the next, and how far the origin is inside."""
    found = []
    for (a, b), (c, d) in zip(corners, corners[1:] + corners[:1], strict=True):
        x, y = c - a, d - b
        length = math.hypot(x, y) or 1.0
        found.append((y / length, -x / length, (a * y - b * x) / length))
    return found


@functools.lru_cache(maxsize=256)
def _rows(layout: MemoryLayout, components: tuple[type[Component], ...]) -> tuple[int, ...]:
    return tuple(layout.rows(*components).tolist())


@functools.lru_cache(maxsize=64)
def _looks(layout: MemoryLayout) -> dict[int, Look]:
    """Return the looks that mechanics declare, by row."""
    declared = [module.looks() for module in layout.modules if isinstance(module, HasLooks)]
    return {e: look for each in declared for kind, look in each.items() for e in layout.spans.get(kind, ())}


def walls(scene: Scene, living: bool = True) -> list[int]:
    """Return the rows of walls, in the world or, not `living`, all.

    They are solids that were static when the episode began, without agents, boxes, sensors, and what has a look or a
    layer of its own: what is locked later stays what it was.
    """
    if Solid not in scene:
        return []
    shown: set[type[Component]] = {Side, Box, *scene.shown}
    others = {e for part in shown for e in scene.rows(part)} | scene.looks.keys()
    dynamic, sensors = scene.prefab(Solid).dynamic, scene.prefab(Filter).sensor if Filter in scene else None
    rows = scene.living(Body, Shape, Solid) if living else scene.rows(Body, Shape, Solid)
    return [e for e in rows if not (dynamic[e] or e in others or (sensors and sensors[e]))]


def has_size(scene: Scene, e: int) -> bool:
    """Return whether the entity in this row has a shape with a size."""
    shape = scene.shape
    return bool(max(shape.radius[e], shape.half_width[e], shape.half_height[e]) > 0)


def owner_of(scene: Scene, item: int) -> int:
    """Return the side that owns the box of which row `item` is the broken form, -1: none."""
    return int(scene[Guard].vulnerable_only_to[scene.rows(Box)[scene[BoxItem].index[item]]])


@functools.lru_cache(maxsize=64)
def kinds(layout: MemoryLayout) -> tuple[str, ...]:
    """Return the name of the kind of each row."""
    return tuple(kind for kind, span in layout.spans.items() for _ in span)


@functools.lru_cache(maxsize=64)
def _shown_rows(layout: MemoryLayout, shown: frozenset[type[Component]] = frozenset()) -> set[int]:
    """Return the rows, in the world or not, that have a component by which some layer shows them."""
    return {e for component in shown.union(KNOWN) for e in layout.rows(component).tolist()}


def unknown(scene: Scene, living: bool = True) -> list[int]:
    """Return the rows of bodies that neither outlast's own layers draw nor any layer that names them in `shows`."""
    known = _shown_rows(scene.worlds.layout, frozenset(scene.shown))
    rows = [e for e in (scene.living(Body) if living else scene.rows(Body)) if e not in known]
    fixed = {*walls(scene, living)} if rows else {}
    return [e for e in rows if e not in fixed]


def of_kind(scene: Scene, e: int) -> Color:
    """Return the colour of the kind of this row: that of its look, or else one by the order of kinds."""
    if e in scene.looks and (color := scene.looks[e].color):
        return color
    layout = scene.worlds.layout
    own = [kind for kind, span in layout.spans.items() if _shown_rows(layout).isdisjoint(span)]
    return KINDS[own.index(kinds(layout)[e]) % len(KINDS)]
