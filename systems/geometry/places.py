"""Free places: whether two bodies are apart, and a search for free places of bodies.

An area is a row of float32: x, y, width, height and angle of a rectangle, metres and radians, and its use, the kind of
entities that start in it: side + 1, `kind_use` of a kind, ITEMS or ANYWHERE.
"""

from typing import Any

import numpy as np

from outlast.components.polygon import is_polygon
from outlast.ecs import Array, Real, kernel
from outlast.ecs.kernels.random import stream_number, uniform, uniform2
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH

from .aabb import ALONG_X, ALONG_Y, aabbs_near_point, compute_aabbs
from .blocks import first_row
from .broad_phase import gap
from .points import to_local

X, Y, WIDTH, HEIGHT, ANGLE, USE, ENTRY = range(7)  # indices into an area; ENTRY: its length
ANYWHERE, ITEMS, WALL = -2, -1, 0  # uses; side s has the use s + 1, kinds have those from KINDS downwards
KINDS, KIND_BITS = -16, np.int64(41)  # a kind's use is KINDS less the upper bits of its identities, exact in float32
MARGIN = np.float32(0.02)  # metres left between bodies
SMALLEST = np.float32(0.1)  # metres: a box is not cut any more if both its half sides are this short
TRIES = 32  # random places tested before all points of a lattice
LATTICE = 40  # points of the lattice along either side of an area
STRIDE = 20  # indices of draws for one body are 2**20 apart: more than the entities of a kind
HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)


def kind_use(kind: str) -> int:
    """Return the use of areas in which entities of a kind start. Take it as a constant of your module in kernels."""
    return KINDS - (stream_number(kind) >> 33 << 32 >> int(KIND_BITS))


@kernel
def set_area(areas: Array, k: int, use: int, x: Real, y: Real, width: Real, height: Real, angle: Real) -> None:
    """Write start area `k` of `Write[StartAreas]`, metres and radians; use: side + 1, or `kind_use` of a kind."""
    row = areas.area[k]
    row[X], row[Y], row[WIDTH], row[HEIGHT], row[ANGLE], row[USE] = x, y, width, height, angle, use


@kernel
def extent(half_width: Real, half_height: Real, cosine: Real, sine: Real, ux: Real, uy: Real) -> Real:
    """Return half the length of a rectangle's projection on the axis (ux, uy), a unit vector."""
    along, across = to_local(ux, uy, cosine, sine)
    return half_width * abs(along) + half_height * abs(across)


@kernel
def apart(body: Array, shape: Array, e: int, o: int) -> bool:
    """Return whether two bodies are at least MARGIN apart; for two rectangles, along a side of one of them."""
    x, y = body.x[o] - body.x[e], body.y[o] - body.y[e]
    reach = shape.radius[e] + shape.half_width[e] + shape.half_height[e]
    reach += shape.radius[o] + shape.half_width[o] + shape.half_height[o] + MARGIN
    if abs(x) >= reach or abs(y) >= reach:
        return True
    if shape.radius[e] > ZERO and shape.radius[o] > ZERO:
        far = shape.radius[e] + shape.radius[o] + MARGIN
        return bool(x * x + y * y >= far * far)
    if shape.radius[e] > ZERO or shape.radius[o] > ZERO:
        circle, box = (e, o) if shape.radius[e] > ZERO else (o, e)
        return bool(gap(body, shape, circle, box) >= MARGIN)
    for k in range(4):
        owner = e if k < 2 else o
        c, s = body.cosine[owner], body.sine[owner]
        ux, uy = (c, s) if k % 2 == 0 else (-s, c)
        one = extent(shape.half_width[e], shape.half_height[e], body.cosine[e], body.sine[e], ux, uy)
        two = extent(shape.half_width[o], shape.half_height[o], body.cosine[o], body.sine[o], ux, uy)
        if abs(ux * x + uy * y) >= one + two + MARGIN:
            return True
    return False


@kernel
def is_free(tables: Any, e: int) -> bool:
    """Return whether body `e` stands inside the room and apart from all obstacles.

    tables: Body, Shape, Entity, Floor; half the sides of the AABBs (see aabb); and the obstacles, a bitset by block.
    """
    body, shape, _, floor, half_extents, obstacles = tables
    radius = shape.radius[e] + MARGIN
    wide = radius + extent(shape.half_width[e], shape.half_height[e], body.cosine[e], body.sine[e], ONE, ZERO)
    high = radius + extent(shape.half_width[e], shape.half_height[e], body.cosine[e], body.sine[e], ZERO, ONE)
    x, y = abs(body.x[e]) + wide, abs(body.y[e]) + high
    if x > HALF * floor.size[0] or y > HALF * floor.size[floor.size.size - 1]:
        return False
    aabbs = (body.x, body.y, half_extents[ALONG_X], half_extents[ALONG_Y])
    for b in range(obstacles.size):
        if obstacles[b]:
            pending = obstacles[b] & aabbs_near_point(aabbs, b, body.x[e], body.y[e], max(wide, high))
            while pending:
                if not apart(body, shape, e, first_row(b, pending)):
                    return False
                pending &= pending - 1
    return True


@kernel
def in_area(body: Array, e: int, areas: Array, use: int) -> bool:
    """Return whether the centre of body `e` is in one of the areas for `use`."""
    for n in range(areas.shape[0]):
        if is_for(areas, n, use):
            cosine, sine = np.cos(areas[n, ANGLE]), np.sin(areas[n, ANGLE])
            x, y = to_local(body.x[e] - areas[n, X], body.y[e] - areas[n, Y], cosine, sine)
            if abs(x) <= HALF * areas[n, WIDTH] and abs(y) <= HALF * areas[n, HEIGHT]:
                return True
    return False


@kernel
def is_for(areas: Array, n: int, use: int) -> bool:
    """Return whether area `n` is for `use`."""
    return bool(areas[n, USE] == use and areas[n, WIDTH] > ZERO)


@kernel
def move_into(body: Array, e: int, area: Array, u: Real, v: Real) -> None:
    """Put body `e` at the fractions u and v of an area's width and height."""
    cosine, sine = np.cos(area[ANGLE]), np.sin(area[ANGLE])
    x, y = (u - HALF) * area[WIDTH], (v - HALF) * area[HEIGHT]
    body.x[e], body.y[e] = area[X] + cosine * x - sine * y, area[Y] + sine * x + cosine * y


@kernel
def drawn_area(areas: Array, use: int, share: Real) -> int:
    """Return the area for `use` in which this share of their total floor ends; -1 without one."""
    total, found = ZERO, -1
    for n in range(areas.shape[0]):
        if is_for(areas, n, use):
            total += areas[n, WIDTH] * areas[n, HEIGHT]
    left = share * total
    for n in range(areas.shape[0]):
        if is_for(areas, n, use):
            found = n
            left -= areas[n, WIDTH] * areas[n, HEIGHT]
            if left < ZERO:
                break
    return found


@kernel
def find_place(tables: Any, e: int, areas: Array, use: int, key: Any) -> bool:
    """Move body `e` to a random free place in the areas for `use`. Return False, at any place, if none is found."""
    body, entities = tables[0], tables[2]
    identity = entities.identity[e]
    for t in range(TRIES):
        index = identity + (2 * t << STRIDE)
        u, v = uniform2(key, index)
        move_into(body, e, areas[drawn_area(areas, use, uniform(key, index + (1 << STRIDE)))], u, v)
        if is_free(tables, e):
            return True
    return False


@kernel
def scan_places(tables: Any, e: int, areas: Array, use: int, key: Any) -> bool:
    """Do the same on a lattice from a random point. Finds places that random draws miss, but is slower."""
    body, entities = tables[0], tables[2]
    points = areas.shape[0] * LATTICE * LATTICE
    first = int(uniform(key, entities.identity[e] + (2 * TRIES << STRIDE)) * np.float32(points))
    for k_point in range(points):
        point = (first + k_point) % points
        n, place = point // (LATTICE * LATTICE), point % (LATTICE * LATTICE)
        if not is_for(areas, n, use):
            continue
        u = (np.float32(place % LATTICE) + HALF) / np.float32(LATTICE)
        v = (np.float32(place // LATTICE) + HALF) / np.float32(LATTICE)
        move_into(body, e, areas[n], u, v)
        if is_free(tables, e):
            return True
    return False


@kernel
def fill_floor(area: Array, floor: Array) -> None:
    """Set an area to cover the room."""
    area[:] = 0
    area[WIDTH], area[HEIGHT], area[USE] = floor.size[0], floor.size[floor.size.size - 1], ANYWHERE


@kernel
def has_area(areas: Array, use: int) -> bool:
    """Return whether an area for `use` exists."""
    for n in range(areas.shape[0]):
        if is_for(areas, n, use):
            return True
    return False


@kernel
def place_body(tables: Any, e: int, areas: Array, use: int, key: Any, polygons: Any) -> bool:
    """Move body `e` to a free place; a rectangle is halved until it finds one. Return False if none exists."""
    shape = tables[1]
    if find_place(tables, e, areas, use, key):
        return True
    resized = shape.radius[e] == ZERO and not is_polygon(polygons, e)
    while resized and max(shape.half_width[e], shape.half_height[e]) > SMALLEST:
        if shape.half_width[e] > shape.half_height[e]:
            shape.half_width[e] *= HALF
        else:
            shape.half_height[e] *= HALF
        if find_place(tables, e, areas, use, key):
            return True
    return bool(scan_places(tables, e, areas, use, key))


@kernel
def measure(wall: Array, walls: Array, half_extents: Array, body: Array, shape: Array) -> None:
    """Compute half the sides of all bodies' AABBs; those of blocks are kept, since they do not change in an episode."""
    compute_aabbs(half_extents, body, shape)
    for o in walls:
        wall.half_x[o], wall.half_y[o] = half_extents[ALONG_X, o], half_extents[ALONG_Y, o]


@kernel
def add_obstacle(obstacles: Array, e: int) -> None:
    """Add a row to a bitset by block."""
    obstacles[e >> SIMD_SHIFT] |= np.int32(1 << (e & SIMD_WIDTH - 1))


@kernel
def place_all(
    tables: Any, spawned: Array, side: Array, solids: Array, rows: Any, areas: Array, key: Any, polygons: Any
) -> int:
    """Move every body without a free place to one: round ones in order of rows, then rectangles, which can be halved.

    Args:
        tables: See `is_free`; this function writes the obstacles, `measure` the half sides.
        spawned: The table of Spawned; bodies that are moved lose their cells.
        side: The table of Side.
        solids: Rows of all solid bodies.
        rows: Rows of all bodies to place; by row, the index of each among these, and the number of the agent (or -1).
        areas: The start areas; the last one is the room. Agents start in those of their side, or of their kind; others
            in those of their kind, or of items; bodies without an area start anywhere.
        key: Key of random numbers.
        polygons: The table of Polygon, or None.

    Returns:
        Number of bodies without a place.
    """
    entities, obstacles = tables[2], tables[5]
    placed, index, agents = rows
    obstacles[:] = 0
    for o in solids:
        if index[o] < 0 and entities.alive[o]:
            add_obstacle(obstacles, o)
    missed = 0
    for n in range(2 * placed.size):
        e = placed[n % placed.size]
        if entities.identity[e] < 0 or (tables[1].radius[e] > ZERO) != (n < placed.size):  # absent, or not its turn
            continue
        use, kind = side.side[e] + 1 if agents[e] >= 0 else ITEMS, KINDS - (entities.identity[e] >> KIND_BITS)
        if agents[e] < 0 or not has_area(areas, use):
            use = kind if has_area(areas, kind) else use
        if not has_area(areas, use):
            use = ANYWHERE
        if not (in_area(tables[0], e, areas, use) and is_free(tables, e)):
            spawned.cell[e] = -1
            missed += not place_body(tables, e, areas, use, key, polygons)
        add_obstacle(obstacles, e)
    return missed
