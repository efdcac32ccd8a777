"""Blocks as barriers: bodies pushed into a block stay outside, and strikes aimed through a block hit it."""

from typing import Any

import numpy as np

from outlast.components.contact import clear_bits, pushes
from outlast.ecs import Array, kernel

from .aabb import aabbs_hit_by_ray, aabbs_near_point
from .blocks import alive_bits, first_row
from .points import to_local
from .rays import NO_HIT, raycast_entity

PASSES = 4  # maximum passes over all walls: a body held back from one may still be in another
ZERO = np.float32(0)


@kernel
def centre_inside(body: Array, shape: Array, e: int, o: int) -> bool:
    """Return whether the centre of body `e` is in rectangle `o`."""
    x, y = to_local(body.x[e] - body.x[o], body.y[e] - body.y[o], body.cosine[o], body.sine[o])
    return bool(abs(x) < shape.half_width[o] and abs(y) < shape.half_height[o])


@kernel
def crossed(body: Array, before: Array, shape: Array, e: int, o: int) -> bool:
    """Return whether the centre of body `e` came into rectangle `o`, or through it, in this tick."""
    if centre_inside(body, shape, e, o):
        return True
    x, y = before.x[e], before.y[e]
    return bool(raycast_entity(body, shape, x, y, body.x[e] - x, body.y[e] - y, o) < NO_HIT)


@kernel
def step_back(body: Array, before: Array, shape: Array, e: int, o: int) -> None:
    """Undo the motion of body `e` towards rectangle `o`, and its speed in that direction, but not along the side.

    A body that was inside before the tick, possible only in a state that was set, is not changed.
    """
    cosine, sine = body.cosine[o], body.sine[o]
    x, y = to_local(body.x[e] - body.x[o], body.y[e] - body.y[o], cosine, sine)
    old_x, old_y = to_local(before.x[e] - body.x[o], before.y[e] - body.y[o], cosine, sine)
    vx, vy = to_local(body.vx[e], body.vy[e], cosine, sine)
    beside, above = abs(old_x) - shape.half_width[o], abs(old_y) - shape.half_height[o]
    if max(beside, above) < ZERO:
        return
    if beside >= above:
        x, vx = old_x, max(vx, ZERO) if old_x > ZERO else min(vx, ZERO)
    else:
        y, vy = old_y, max(vy, ZERO) if old_y > ZERO else min(vy, ZERO)
    body.x[e], body.y[e] = body.x[o] + cosine * x - sine * y, body.y[o] + sine * x + cosine * y
    body.vx[e], body.vy[e] = cosine * vx - sine * vy, sine * vx + cosine * vy


@kernel
def hold_back(
    body: Array,
    before: Array,
    shape: Array,
    wall: Array,
    entities: Array,
    filters: Any,
    filtered: Any,
    walls: Array,
    span: Any,
    e: int,
) -> None:
    """Keep body `e` on the side of all walls where it was before it moved, except those that its filter passes.

    walls: bitset of the rows of walls. span: the range of its blocks that are not empty, see `block_span`.
    """
    aabbs = (body.x, body.y, wall.half_x, wall.half_y)
    for _ in range(PASSES):
        free, moved = True, abs(body.x[e] - before.x[e]) + abs(body.y[e] - before.y[e])
        for b in range(span[0], span[1]):
            near = walls[b] & aabbs_near_point(aabbs, b, body.x[e], body.y[e], moved)
            pending = near & alive_bits(entities, walls, b) if near else 0
            while pending:
                o = first_row(b, pending)
                pending &= pending - 1
                if pushes(filters, filtered, e, o) and crossed(body, before, shape, e, o):
                    step_back(body, before, shape, e, o)
                    free = False
        if free:
            return
    body.x[e], body.y[e], body.vx[e], body.vy[e] = before.x[e], before.y[e], ZERO, ZERO


@kernel
def first_barrier(
    body: Array,
    shape: Array,
    wall: Array,
    entities: Array,
    filters: Any,
    walls: Array,
    span: Any,
    me: int,
    target: int,
    polygons: Any,
) -> int:
    """Return the first block on the straight way ahead from `me` to body `target`, or `target` itself."""
    aabbs = (body.x, body.y, wall.half_x, wall.half_y)
    ox, oy = body.x[me], body.y[me]
    reach = abs(body.x[target] - ox) + abs(body.y[target] - oy)
    reach += shape.radius[target] + shape.half_width[target] + shape.half_height[target]
    dx, dy = reach * body.cosine[me], reach * body.sine[me]
    found, nearest = target, raycast_entity(body, shape, ox, oy, dx, dy, target, polygons)
    for b in range(span[0], span[1]):
        hit = walls[b] & aabbs_hit_by_ray(aabbs, b, ox, oy, dx, dy) & ~clear_bits(filters, b)
        pending = hit & alive_bits(entities, walls, b) if hit else 0
        while pending:
            o = first_row(b, pending)
            pending &= pending - 1
            at = raycast_entity(body, shape, ox, oy, dx, dy, o)
            if at < nearest:
                found, nearest = o, at
    return int(found)
