"""Need for Box2D's continuous collision (b2World::SolveTOI) after a substep."""

import numpy as np

from outlast.ecs.kernels.jit import noinline_kernel

from . import layout as at
from .batch import Outlines

_NEAREST = np.float32(0.01)  # metres: Box2D keeps the centres of discs smaller than a centimetre 6.25 mm from boxes


@noinline_kernel
def may_hit(workspace: int, outlines: Outlines) -> bool:
    """Return False only if no moving body can have come into a static one; then SolveTOI would change nothing.

    Without this test, SolveTOI costs half a microsecond for every pair that merely rests or passes by.
    """
    contact = at.load_i8(workspace + at.WORLD_MANAGER + at.MANAGER_CONTACTS)
    while contact:
        first, second = at.load_i8(contact + at.CONTACT_FIXTURE_A), at.load_i8(contact + at.CONTACT_FIXTURE_B)
        a, b = at.load_i8(first + at.FIXTURE_BODY), at.load_i8(second + at.FIXTURE_BODY)
        if at.load_i4(a + at.BODY_TYPE) != at.load_i4(b + at.BODY_TYPE):
            box, circle = at.load_i8(first + at.FIXTURE_SHAPE), at.load_i8(second + at.FIXTURE_SHAPE)
            usual = at.load_i4(b + at.BODY_TYPE) == at.MOVING and at.load_i4(circle + at.SHAPE_TYPE) == at.CIRCLE
            usual = usual and at.load_i4(box + at.SHAPE_TYPE) == at.POLYGON
            usual = usual and at.load_i4(a + at.BODY_TYPE) == at.STATIC
            if not usual or not _passes(a, b, box, at.load_f4(circle + at.CIRCLE_RADIUS), outlines):
                return True  # unusual: a moving box, or a static circle
        contact = at.load_i8(contact + at.CONTACT_NEXT)
    return False


@noinline_kernel
def _passes(body: int, circle: int, box: int, radius: np.float32, outlines: Outlines) -> bool:
    """Return whether the circle stays on the outer side of one of the static box's sides all along its path.

    Around a polygon, the sides are those of the rectangle around it.
    Box2D stops a circle's centre at radius - 3.75 mm from the box; the full radius allows for rounding.
    """
    radius = max(radius, _NEAREST)
    c, s = at.load_f4(body + at.BODY_COS), at.load_f4(body + at.BODY_SIN)
    x, y = at.load_f4(body + at.BODY_POSITION), at.load_f4(body + at.BODY_POSITION + 4)
    ax, ay = at.load_f4(circle + at.BODY_CENTER0) - x, at.load_f4(circle + at.BODY_CENTER0 + 4) - y
    bx, by = at.load_f4(circle + at.BODY_CENTER) - x, at.load_f4(circle + at.BODY_CENTER + 4) - y
    ax, ay = c * ax + s * ay, c * ay - s * ax
    bx, by = c * bx + s * by, c * by - s * bx
    width, height = at.load_f4(box + at.POLYGON_VERTICES + 16), at.load_f4(box + at.POLYGON_VERTICES + 20)
    if outlines is not None:
        width, height = _half_sides(box)
    width += radius
    height += radius
    beside = min(ax, bx) >= width or max(ax, bx) <= -width
    return bool(beside or min(ay, by) >= height or max(ay, by) <= -height)


@noinline_kernel
def _half_sides(polygon: int) -> tuple[np.float32, np.float32]:
    """Return half the sides of the rectangle around a polygon, in its own frame."""
    width, height = np.float32(0), np.float32(0)
    for k in range(at.load_i4(polygon + at.POLYGON_COUNT)):
        width = max(width, abs(at.load_f4(polygon + at.POLYGON_VERTICES + 8 * k)))
        height = max(height, abs(at.load_f4(polygon + at.POLYGON_VERTICES + 8 * k + 4)))
    return width, height
