"""The scene: one world in the form that layers read."""

import dataclasses
import functools
import math
from typing import Any, TypeVar

from outlast.components import Body, Floor, Polygon, Shape, Side, Sides
from outlast.components.agent import side_names
from outlast.components.look import NOTHING, HasLooks, Look
from outlast.ecs import Clock, Component, Entity, Event, MemoryLayout, Module, Worlds
from outlast.ecs.memory.numbers import Number, Varied

from .style import SIZES

M = TypeVar("M", bound=Module)

THINNEST = 1e-9  # metres: half the width of a rectangle without any


class Scene:
    """World `w` in plain Python: scene[C] is the table of component C, its columns as lists of Python numbers.

    The lists are copies, made on first use, so a layer cannot change the world; and reading numbers from lists is ten
    times faster than from arrays. sides: distances from the origin to the edges of the room along x and y, metres.
    room: the larger of them. half: distance to the edge of the picture, which is a little larger.
    """

    def __init__(self, worlds: Worlds, w: int) -> None:
        self.worlds, self.w = worlds, w
        self._tables: dict[type[Component], Any] = {}
        self.body, self.shape = self[Body], self[Shape]
        self._alive = self[Entity].alive
        self.sides = self._reach()
        self.room = max(self.sides)
        self.half = SIZES.margin * self.room
        self.shown: set[type[Component]] = set()  # components whose entities the picture's layers draw, see Layer.shows

    def __getitem__(self, component: type[Component]) -> Any:
        table = self._tables.get(component)
        if table is None:
            columns = (column[self.w].tolist() for column in self.worlds[component])
            table = self._tables[component] = component.Table(*columns)
        return table

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
        alive = self._alive
        return [e for e in _rows(self.worlds.layout, components) if alive[e]]

    def rows(self, *components: type[Component]) -> tuple[int, ...]:
        """Return the rows of all entities with all of these components, in the world or not; agents in order of id."""
        return _rows(self.worlds.layout, components)

    @functools.cached_property
    def looks(self) -> dict[int, Look]:
        """The looks that mechanics declare, by row."""
        declared = [module.looks() for module in self.worlds.layout.modules if isinstance(module, HasLooks)]
        spans = self.worlds.layout.spans
        return {e: look for each in declared for kind, look in each.items() for e in spans.get(kind, ())}

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

    def placed_corners(self, e: int, grow: float = 0) -> list[tuple[float, float]]:
        """Return the corners of a polygon where it is, each side moved outwards by `grow` metres."""
        found, corners = [], self.corners(e)
        sides = [side_of(one, two) for one, two in zip(corners, corners[1:] + corners[:1], strict=True)]
        x, y, cosine, sine = self.body.x[e], self.body.y[e], self.body.cosine[e], self.body.sine[e]
        for k, (a, b) in enumerate(corners):
            (ux, uy, _), (vx, vy, _) = sides[k - 1], sides[k]
            far = grow / (1 + ux * vx + uy * vy)
            a, b = a + far * (ux + vx), b + far * (uy + vy)
            found.append((x + a * cosine - b * sine, y + a * sine + b * cosine))
        return found

    def outline(self, e: int) -> list[tuple[float, float]]:
        """Return the corners of a polygon or a rectangle where it is, counter-clockwise."""
        if corners := self.placed_corners(e):
            return corners
        body, x, y = self.body, max(self.shape.half_width[e], THINNEST), max(self.shape.half_height[e], THINNEST)
        corner = complex(body.cosine[e], body.sine[e])
        turned = [corner * complex(a, b) for a, b in ((-x, -y), (x, -y), (x, y), (-x, y))]
        return [(body.x[e] + each.real, body.y[e] + each.imag) for each in turned]

    def least_half(self, e: int) -> float:
        """Return how far the middle of a body is from its nearest side, metres."""
        if corners := self.corners(e):
            return min(side_of(one, two)[2] for one, two in zip(corners, corners[1:] + corners[:1], strict=True))
        return float(self.shape.radius[e] or min(self.shape.half_width[e], self.shape.half_height[e]))

    def side_name(self, side: int) -> str:
        """Return a side's name (see side_names), or its number if a mechanic of the user's makes the teams."""
        layout, teams = self.worlds.layout, Sides in self and self[Sides].teams[0]
        names = side_names(layout) if layout.groups() or not teams else ()
        return names[side] if side < len(names) else f"{'team' if teams else 'agent'} {side}"

    def prefab(self, component: type[Component]) -> Any:
        """Return the table as it is at the start of an episode."""
        if self.worlds.layout.per_agent or self.worlds.layout.varied:
            return _table(self.worlds.layout, component, self.worlds.initial_image(self.w))
        return _birth(self.worlds.layout, component)  # type: ignore[arg-type]  # classes can be hashed

    def mechanic(self, kind: type[M], agent: int | None = None) -> M:
        """Return the mechanic of this class with the numbers of this world, or of the agent in a row of it.

        KeyError if this scenario lacks it.
        """
        layout = self.worlds.layout
        for k, module in enumerate(self.worlds.modules):
            if isinstance(module, kind):
                drawn = {each.field: self._drawn(each) for each in layout.varied.values() if each.module == k}
                if agent is not None and self[Clock].episode[0]:  # before a reset, agents have no roles
                    i, own = self.rows(Side).index(agent), [n for n in layout.per_agent.values() if n.module == k]
                    drawn |= {number.field: self.worlds.agent_values(number)[self.w, i].item() for number in own}
                return module.replace(**_in_range(module, drawn)) if drawn else module
        raise KeyError(f"this scenario has no mechanic {kind.__name__}")

    def _drawn(self, number: Number) -> Any:
        """Return the value that a varied number has in this world."""
        words = self.worlds[Varied].words[self.w, :, None].copy()
        value = number.decode(words, self.worlds.modules[number.module])[0]
        return tuple(value.tolist()) if value.ndim else value.item()

    def _reach(self) -> tuple[float, float]:
        if Floor in self.worlds:
            sides = self[Floor].size
            return sides[0] / 2, sides[-1] / 2
        x, y, bound = self.body.x, self.body.y, self.shape.bound
        ends = [max(abs(x[e]), abs(y[e])) + bound[e] for e in self.living(Body, Shape)]
        reach: float = max([1.0, *(end for end in ends if math.isfinite(end))])
        return reach, reach


def side_of(one: tuple[float, float], two: tuple[float, float]) -> tuple[float, float, float]:
    """Return the outer normal of a side between two corners, counter-clockwise, and how far the origin is inside."""
    x, y = two[0] - one[0], two[1] - one[1]
    length = math.hypot(x, y) or 1.0
    return y / length, -x / length, (one[0] * y - one[1] * x) / length


def _in_range(module: Module, numbers: dict[str, Any]) -> dict[str, Any]:
    """Return numbers of a world, clipped to their ranges, as rounding to float32 may have moved them out."""
    rules = {item.name: item.metadata for item in dataclasses.fields(module)}
    ends = {name: (rules[name].get("low", -math.inf), rules[name].get("high", math.inf)) for name in numbers}
    return {
        name: min(max(value, ends[name][0]), ends[name][1]) if isinstance(value, float) else value
        for name, value in numbers.items()
    }


@functools.lru_cache(maxsize=256)
def _rows(layout: MemoryLayout, components: tuple[type[Component], ...]) -> tuple[int, ...]:
    return tuple(layout.rows(*components).tolist())


@functools.lru_cache(maxsize=64)
def _birth(layout: MemoryLayout, component: type[Component]) -> Any:
    return _table(layout, component, layout.initial_image)


def _table(layout: MemoryLayout, component: type[Component], image: Any) -> Any:
    """Return the table of a component from the state of a world."""
    return component.Table(*(tuple(column[0].tolist()) for column in layout.columns(image[None], component)))
