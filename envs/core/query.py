"""Queries of bodies from Python: the kernels of mechanics, run as Python."""

from typing import Any

import numpy as np

from outlast.components import Body, Polygon, Shape
from outlast.ecs import Component, Entity, Worlds
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.kernels.jit import interpreted
from outlast.systems.geometry import bodies, queries

Kind = type[Component]


class Query:
    """Queries of one world, from its tables at the time of each call.

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
        body, shape, entities = (type(t)(*(column[w] for column in t)) for t in map(worlds.__getitem__, PARTS))
        every = worlds.layout.bitset(Shape)
        index = bodies.make_index(worlds.dims)._replace(body=body, shape=shape, entities=entities, members=every)
        if Polygon in worlds:
            index = index._replace(polygons=Polygon.Table(*(column[w] for column in worlds[Polygon])))
        return index, worlds.layout.bitset(Shape, *kinds) if kinds else every


PARTS = (Body, Shape, Entity)
