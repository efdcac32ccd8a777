"""One world from Python: queries of its bodies, and entities put into it by hand, for tests and scripts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.components import Body, Item, Polygon, Shape, Wall
from outlast.components.body import HEADING, face
from outlast.ecs import Component, Entity, Worlds
from outlast.ecs.declarations.component import as_stored
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.kernels.jit import interpreted
from outlast.systems.geometry import bodies, queries
from outlast.systems.geometry.aabb import make_half_extents
from outlast.systems.geometry.places import measure

REST = ("vx", "vy", "omega")
Kind = type[Component]


class Query:
    """Queries of one world, by the kernels of mechanics, from its tables at the time of each call.

    Entities are rows (`env.worlds.span("box").start` is the first box). *kinds: components that the rows must have, as
    in `near(0, 0, 2.0, Side)`; without any, all bodies count. Only living ones do. Distances are between outlines, in
    metres.

    Raises:
        ValueError: The world or the row does not exist.
    """

    def __init__(self, worlds: Worlds, world: int = 0) -> None:
        if not is_whole(world, 0, worlds.count - 1):
            raise ValueError(f"world = {world!r:.60}: there are the worlds 0 to {worlds.count - 1}")
        self._worlds, self._world = worlds, int(world)

    def near(self, x: float, y: float, far: float, *kinds: Kind) -> list[int]:
        """Return the bodies at most `far` metres from a point."""
        return self._listed(queries.around, kinds, np.float32(x), np.float32(y), np.float32(far))

    def within(self, e: int, far: float, *kinds: Kind) -> list[int]:
        """Return the other bodies at most `far` metres from body `e`; for 0, those that it overlaps."""
        return self._listed(queries.within, kinds, self._row(e), np.float32(far))

    def nearest(self, e: int, far: float, *kinds: Kind) -> int:
        """Return the other body that is nearest to body `e`, at most `far` metres away; -1: none."""
        return int(self._ask(queries.nearest, kinds, self._row(e), np.float32(far)))

    def distance(self, e: int, o: int) -> float:
        """Return the metres between two bodies, alive or not; 0 if they overlap."""
        return float(self._ask(queries.distance, None, self._row(e), self._row(o)))

    def overlap(self, e: int, o: int) -> bool:
        """Return whether two bodies overlap or touch, alive or not."""
        return bool(self._ask(queries.overlap, None, self._row(e), self._row(o)))

    def first_on_ray(
        self, x: float, y: float, dx: float, dy: float, *kinds: Kind, skip: int = -1
    ) -> tuple[int, float] | None:
        """Return the first body that the ray from (x, y) to (x + dx, y + dy) enters, and how far along; None: none.

        Args:
            x: Where it begins, metres. A body that contains this point is not entered.
            y: Its second coordinate, metres.
            dx: Its extent along x, metres.
            dy: Its extent along y, metres.
            *kinds: Components of the bodies that count.
            skip: The row of a body that does not count, such as the observer's.

        Returns:
            Its row, and the fraction of the ray at which it is entered, 0 to 1.
        """
        row, at = self._ask(queries.first_on_ray, kinds, *map(np.float32, (x, y, dx, dy)), skip)
        return None if row < 0 else (int(row), float(at))

    def line_of_sight(self, e: int, o: int, *kinds: Kind) -> bool:
        """Return whether none of the other bodies, of these kinds, is between the centre of `e` and body `o`."""
        return bool(self._ask(queries.line_of_sight, kinds, self._row(e), self._row(o)))

    def _row(self, e: Any) -> int:
        if not is_whole(e, 0, self._worlds.dims["rows"] - 1):
            raise ValueError(f"row {e!r:.60} does not exist: there are {self._worlds.dims['rows']}, from 0 on")
        return int(e)

    def _listed(self, kernel: Any, kinds: tuple[Kind, ...], *given: Any) -> list[int]:
        index, members = self._index(kinds)
        with interpreted():
            return [int(e) for e in index.rows[: kernel(index, members, *given)]]

    def _ask(self, kernel: Any, kinds: tuple[Kind, ...] | None, *given: Any) -> Any:
        """Call a kernel; kinds: None if it takes no members."""
        index, members = self._index(kinds or ())
        with interpreted():
            return kernel(index, *(() if kinds is None else (members,)), *given)

    def _index(self, kinds: tuple[Kind, ...]) -> tuple[Any, Any]:
        worlds, w = self._worlds, self._world
        body, shape, entities = (_of_world(worlds, part, w) for part in (Body, Shape, Entity))
        every = worlds.layout.bitset(Shape)
        index = bodies.make_index(worlds.dims)._replace(body=body, shape=shape, entities=entities, members=every)
        if Polygon in worlds:
            index = index._replace(polygons=_of_world(worlds, Polygon, w))
        return index, worlds.layout.bitset(Shape, *kinds) if kinds else every


def place(worlds: Worlds, kind: str, number: int, where: Any, values: Mapping[str, Any]) -> int:
    """Put an entity into the worlds `where`; see SurvivalVectorEnv.place, which does not check these arguments."""
    span = worlds.span(kind)
    if not is_whole(number, 0, span.stop - span.start - 1):
        raise ValueError(f"number = {number!r:.60}: there are {span.stop - span.start} of the kind '{kind}', from 0 on")
    row, chosen = int(span.start + number), np.atleast_1d(np.arange(worlds.count)[where])
    parts = [type(part) for part in worlds.layout.archetypes[kind].parts]
    columns = [_column(kind, parts, name) for name in values]
    _check_coupled(columns)
    if outline := [name for own, name in columns if Polygon in parts and own in (Polygon, Shape)]:
        raise ValueError(
            f"{outline[0]}: the outline of the kind '{kind}' is its Polygon; declare another kind for another"
        )
    given = [
        as_stored(f"{own.__name__}.{column}", own.columns[column], value)
        for (own, column), value in zip(columns, values.values(), strict=True)
    ]
    entities = worlds[Entity]
    if absent := chosen[entities.identity[chosen, row] < 0].tolist():
        raise ValueError(f"{kind} {number} is absent in world {absent[0]}, whose episode has fewer of that kind")
    if Item in parts and (carried := chosen[worlds[Item].holder[chosen, row] >= 0].tolist()):
        raise ValueError(
            f"{kind} {number} is in a bag in world {carried[0]}: take it out by a tick in which it is used"
        )
    entities.alive[chosen, row] = 1
    if Body in parts:
        for name in REST:
            getattr(worlds[Body], name)[chosen, row] = 0
    for (own, column), value in zip(columns, given, strict=True):
        getattr(worlds[own], column)[chosen, row] = value
    with interpreted():
        for w in chosen.tolist():
            _couple(worlds, parts, w, row)
    return row


def _column(kind: str, parts: list[type[Component]], name: str) -> tuple[type[Component], str]:
    """Return the component and the column that a name stands for: "points", or "Health.points"; "x" is Body's."""
    owner, _, column = name.rpartition(".")
    found = [part for part in parts if column in part.columns and owner in ("", part.__name__)]
    if len(found) == 1 or Body in found:
        return Body if Body in found else found[0], column
    if found:
        names = " and ".join(f"'{part.__name__}.{column}'" for part in found)
        raise ValueError(
            f"'{column}' of the kind '{kind}' could be {names}: choose one, as in **{{{names.split()[0]}: 1}}"
        )
    known = [each for part in parts for each in part.columns]
    hint = did_you_mean(column, known) or f"it has: {', '.join(dict.fromkeys(known)) or 'none'}"
    raise ValueError(f"the kind '{kind}' has no column '{name}'; {hint}")


def _check_coupled(columns: list[tuple[type[Component], str]]) -> None:
    """Raise ValueError for a column that must fit others which are neither given nor computed here."""
    for own, column in columns:
        for coupled in own.coupled:
            missing = [need for need in coupled.needs if (own, need) not in columns]
            if column in coupled.columns and missing and not coupled.computed_by and coupled.columns != HEADING:
                raise ValueError(f"{own.__name__}.{column} needs {', '.join(missing)}: {coupled.cure}")


def _couple(worlds: Worlds, parts: list[type[Component]], w: int, row: int) -> None:
    """Compute the dependent columns of an entity, by the systems that do so at resets."""
    rows = np.array([row], np.int32)
    if Body in parts:
        body = _of_world(worlds, Body, w)
        face(body, row, body.angle[row])
    computed = {(part, each.computed_by.partition(".")[2]) for part in parts for each in part.coupled}
    made = {"rows": rows, "none": None}  # none: a table that the game lacks
    for system in worlds.schedule.systems:
        if any(system.touches(part, "write") for part, name in computed if name == system.name):
            system.kernel(
                *(made[p.kind] if p.kind in made else _of_world(worlds, p.components[0], w) for p in system.parameters)
            )
    if Wall in parts:
        tables = (_of_world(worlds, part, w) for part in (Body, Shape))
        measure(_of_world(worlds, Wall, w), worlds.layout.rows(Wall), make_half_extents(worlds.dims), *tables)


def _of_world(worlds: Worlds, component: type[Component], w: int) -> Any:
    """Return the table of a component in one world."""
    table = worlds[component]
    return type(table)(*(column[w] for column in table))
