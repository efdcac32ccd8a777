"""The spawn grid: the floor is divided into cells, and every body that spawns at reset gets its own cell."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Body, Floor, Phase, Spawned
from outlast.ecs import Array, Entity, Layout, Module, NumberError, Random, Read, Rows, Singleton, Write, column, number
from outlast.ecs.kernels.random import integer

from .geometry.bounds import count_kinds

SIDE = 256  # maximum cells on a side: their square is limits.MANY


class Cells(Singleton):
    """The cells in the order of their use; drawn at reset."""

    cells: Array = column("i4", "cells")


@dataclass(frozen=True)
class SpawnGrid(Module):
    """A grid of cells with at most one body in each, of any kind (reference rules, section 1)."""

    stream = "spawn"

    cells: int = number(8, low=1, high=SIDE, about="cells on a side of the grid; at most one body starts in a cell")

    def singletons(self) -> Iterable[Singleton]:
        return [Cells()]

    def dims(self) -> dict[str, int | str]:
        return {"cells": self.cells**2}

    def check(self, layout: Layout) -> None:
        room = layout.numbers("room")
        if room.get("walls") and room["thickness"] * self.cells > 1:
            raise NumberError(
                f"room.thickness = {room['thickness']:g}: the walls would cover the middles of the outer cells of "
                f"spawn_grid.cells = {self.cells}; take at most {1 / self.cells:g}, or fewer cells"
            )
        bodies = len(layout.rows(Spawned))
        if bodies > self.cells**2:
            raise NumberError(
                f"{bodies} bodies ({count_kinds(layout, Spawned)}) do not fit into spawn_grid.cells = {self.cells} x "
                f"{self.cells} = {self.cells**2} cells; take fewer bodies or more cells"
            )


@SpawnGrid.system(Phase.SPAWN)
def place(
    body: Write[Body],
    spawned: Write[Spawned],
    cells: Write[Cells],
    entities: Read[Entity],
    floor: Read[Floor],
    rows: Rows[Spawned],
    key: Random,
) -> None:
    """Put each body into a random free cell, facing +x. Agents come first, so items do not affect their cells."""
    side = int(cells.cells.size**0.5 + 0.5)
    for c in range(cells.cells.size):
        cells.cells[c] = c
    k = 0
    for e in rows:
        if entities.identity[e] < 0:  # absent
            continue
        pick = k + integer(key, entities.identity[e], cells.cells.size - k)
        cell = cells.cells[pick]
        cells.cells[pick] = cells.cells[k]
        cells.cells[k] = cell
        spawned.cell[e] = cell
        body.x[e] = floor.size[0] * ((cell % side + 0.5) / side - 0.5)
        body.y[e] = floor.size[floor.size.size - 1] * ((cell // side + 0.5) / side - 0.5)
        k += 1
