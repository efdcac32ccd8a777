"""Whether Box2D's continuous collision (b2World::SolveTOI) can find anything to do after a substep."""

import numpy as np

from outlast.ecs.jit import kernel

from .box2d_layout import (
    BODY_CENTER, BODY_CENTER0, BODY_COS, BODY_POSITION, BODY_SIN, BODY_TYPE, CIRCLE, CIRCLE_RADIUS,
    CONTACT_FIXTURE_A, CONTACT_FIXTURE_B, CONTACT_NEXT, FIXTURE_BODY, FIXTURE_SHAPE, MANAGER_CONTACTS,
    MOVING, POLYGON_VERTICES, SHAPE_TYPE, WORLD_MANAGER, load_f4, load_i4, load_i8,
)  # fmt: skip


@kernel
def may_hit(arena: int) -> bool:
    """False only if no moving body can have come into a static one; then SolveTOI would change nothing.

    Without this test it costs half a microsecond for every pair that merely rests or passes by.
    """
    contact = load_i8(arena + WORLD_MANAGER + MANAGER_CONTACTS)
    while contact:
        first, second = load_i8(contact + CONTACT_FIXTURE_A), load_i8(contact + CONTACT_FIXTURE_B)
        a, b = load_i8(first + FIXTURE_BODY), load_i8(second + FIXTURE_BODY)
        if load_i4(a + BODY_TYPE) != load_i4(b + BODY_TYPE):
            box, circle = load_i8(first + FIXTURE_SHAPE), load_i8(second + FIXTURE_SHAPE)
            if load_i4(circle + SHAPE_TYPE) != CIRCLE or load_i4(box + SHAPE_TYPE) == CIRCLE:
                return True  # rare: a moving box, or a static circle
            if load_i4(b + BODY_TYPE) != MOVING or not _passes(a, b, box, load_f4(circle + CIRCLE_RADIUS)):
                return True
        contact = load_i8(contact + CONTACT_NEXT)
    return False


@kernel
def _passes(body: int, circle: int, box: int, radius: np.float32) -> bool:
    """Whether one side of the static box has the circle on its outside all along the circle's path.

    Box2D stops a circle's centre at radius - 3.75 mm from the box; the whole radius leaves room for rounding.
    """
    c, s = load_f4(body + BODY_COS), load_f4(body + BODY_SIN)
    x, y = load_f4(body + BODY_POSITION), load_f4(body + BODY_POSITION + 4)
    ax, ay = load_f4(circle + BODY_CENTER0) - x, load_f4(circle + BODY_CENTER0 + 4) - y
    bx, by = load_f4(circle + BODY_CENTER) - x, load_f4(circle + BODY_CENTER + 4) - y
    ax, ay = c * ax + s * ay, c * ay - s * ax
    bx, by = c * bx + s * by, c * by - s * bx
    width = load_f4(box + POLYGON_VERTICES + 16) + radius
    height = load_f4(box + POLYGON_VERTICES + 20) + radius
    beside = min(ax, bx) >= width or max(ax, bx) <= -width
    return beside or min(ay, by) >= height or max(ay, by) <= -height
