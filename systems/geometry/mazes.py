"""Walls along the lines of a grid of cells, with openings that connect all cells."""

from typing import Any

import numpy as np

from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.random import integer, uniform

MOST = 32  # maximum cells along either side
EDGES = 2 * MOST * (MOST - 1)  # maximum walls between cells
PARENT, ORDER, OPEN = range(3)  # lines of the scratch memory
EXTRA, PLACE = EDGES, 2 * EDGES  # first index for draws of further openings, and of positions of doors
HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)


def make_grid_memory() -> np.ndarray[Any, Any]:
    """Return the scratch of `open_edges`: int32 (3, EDGES)."""
    return np.zeros((3, EDGES), np.int32)


@kernel
def edge_count(columns: int, rows: int) -> int:
    """Return the number of walls between the cells of a grid: the vertical ones, row by row, then the horizontal."""
    return (columns - 1) * rows + columns * (rows - 1)


@kernel
def edge_cells(k: int, columns: int, rows: int) -> tuple[int, int]:
    """Return the two cells that edge `k` divides; cell i + columns * j is in column i and row j."""
    upright = (columns - 1) * rows
    if k < upright:
        cell = k % (columns - 1) + columns * (k // (columns - 1))
        return cell, cell + 1
    return k - upright, k - upright + columns


@kernel
def root(memory: Array, cell: int) -> int:
    """Return the cell that represents all cells connected to this one."""
    while memory[PARENT, cell] != cell:
        memory[PARENT, cell] = memory[PARENT, memory[PARENT, cell]]
        cell = memory[PARENT, cell]
    return cell


@kernel
def open_edges(memory: Array, columns: int, rows: int, extra: Real, key: Any) -> int:
    """Draw the edges with an opening: those of a random spanning tree (Kruskal), and a share of the others.

    Args:
        memory: Memory from `make_grid_memory`; its line OPEN becomes 1 for each edge with an opening.
        columns: Cells from left to right.
        rows: Cells from bottom to top.
        extra: Probability of an opening between cells that are already connected.
        key: Key of random numbers.

    Returns:
        Number of edges.
    """
    edges = edge_count(columns, rows)
    for cell in range(columns * rows):
        memory[PARENT, cell] = cell
    for k in range(edges):
        memory[ORDER, k] = k
    for k in range(edges):
        pick = k + int(integer(key, k, edges - k))
        edge = memory[ORDER, pick]
        memory[ORDER, pick] = memory[ORDER, k]
        memory[ORDER, k] = edge
        one, two = edge_cells(edge, columns, rows)
        one, two = root(memory, one), root(memory, two)
        memory[OPEN, edge] = 1
        if one != two:
            memory[PARENT, one] = two
        elif uniform(key, EXTRA + edge) >= extra:
            memory[OPEN, edge] = 0
    return edges


@kernel
def place_block(
    body: Array, shape: Array, entities: Array, e: int, x: Real, y: Real, half_width: Real, half_height: Real
) -> None:
    """Set up block `e`, upright."""
    body.x[e], body.y[e], body.angle[e], body.cosine[e], body.sine[e] = x, y, 0, 1, 0
    shape.half_width[e], shape.half_height[e] = half_width, half_height
    entities.alive[e] = 1


@kernel
def place_span(tables: Any, e: int, line: Real, start: Real, stop: Real, half: Real, upright: bool) -> None:
    """Set up block `e` along a line (if vertical, at x = line from y = start to stop); half: half of its thickness."""
    body, shape, entities = tables
    middle, length = HALF * (start + stop), HALF * (stop - start)
    if upright:
        place_block(body, shape, entities, e, line, middle, half, length)
    else:
        place_block(body, shape, entities, e, middle, line, length, half)


@kernel
def place_edges(
    tables: Any, walls: Array, memory: Array, columns: int, rows: int, sides: Any, thickness: Real, door: Real, key: Any
) -> int:
    """Set up the blocks of all edges; call `open_edges` first.

    Args:
        tables: Body, Shape and Entity.
        walls: Rows of the blocks; at least as many as needed.
        memory: Memory after `open_edges`.
        columns: As for `open_edges`.
        rows: As for `open_edges`.
        sides: Width and height of the floor, metres.
        thickness: Thickness of a wall, metres.
        door: Width of an opening somewhere in its wall, metres; 0: the complete wall is open.
        key: Key of random numbers.

    Returns:
        Number of standing blocks.
    """
    width, height = sides[0] / np.float32(columns), sides[1] / np.float32(rows)
    half, count = HALF * thickness, 0
    for k in range(edge_count(columns, rows)):
        cell, other = edge_cells(k, columns, rows)
        i, j = np.float32(cell % columns), np.float32(cell // columns)
        upright = other == cell + 1
        if upright:
            line, edge, start, length = (i + ONE) * width - HALF * sides[0], HALF * sides[1], j * height, height
        else:
            line, edge, start, length = (j + ONE) * height - HALF * sides[1], HALF * sides[0], i * width, width
        start -= edge
        first, last = max(start - half, -edge), min(start + length + half, edge)
        if not memory[OPEN, k]:
            place_span(tables, walls[count], line, first, last, half, upright)
            count += 1
        elif door > ZERO:
            spare = (length - door) / np.float32(8)  # minimum metres of wall that remain on either side
            opening = start + spare + uniform(key, PLACE + k) * (length - door - spare - spare)
            place_span(tables, walls[count], line, first, opening, half, upright)
            place_span(tables, walls[count + 1], line, opening + door, last, half, upright)
            count += 2
    return count
