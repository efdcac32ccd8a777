"""Items and bodies of mechanics without a layer of their own, drawn from their components."""

import functools
from dataclasses import dataclass

from outlast.components import Body, Box, BoxItem, Heal, Side, Solid
from outlast.ecs import Component, Layout

from ..canvas import Canvas
from ..scene import Scene
from ..style import INK, KINDS, SIZES, Color, mix
from .layer import Layer, ZOrder
from .room import walls
from .title import digit, printable

# entities with these are drawn by outlast's own layers, or not at all if those are not shown
KNOWN = (Side, Box, BoxItem, Heal)
POINT = 0.2  # metres: radius with which a body without a size is drawn


@dataclass(frozen=True)
class OthersLayer(Layer):
    """Items and bodies that no other layer shows: their shapes in the colour of their kind, and the kind's name.

    A layer that draws entities itself names one of their components in `shows`.
    """

    zorder = ZOrder.ITEMS
    rim: float = SIZES.outline
    height: float = 0.45  # metres: height of a digit in names; 0: no names

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw all bodies, then the names that do not overlap with another one."""
        rows = others(scene)
        for e in rows:
            self._draw(canvas, scene, e)
        height, taken = min(self.height, digit(canvas.size) / canvas.scale), list[tuple[float, float, float]]()
        for e in rows if canvas.readable(height) else ():
            _name(canvas, scene, e, height, taken)

    def _draw(self, canvas: Canvas, scene: Scene, e: int) -> None:
        body, shape, color = scene.body, scene.shape, of_kind(scene, e)
        if not has_size(scene, e):
            canvas.circle(body.x[e], body.y[e], POINT, mix(color, INK, 0.6))
            canvas.circle(body.x[e], body.y[e], POINT - self.rim, color)
            return
        canvas.body(scene, e, mix(color, INK, 0.6))
        if (shape.radius[e] or min(shape.half_width[e], shape.half_height[e])) > 2 * self.rim:
            canvas.body(scene, e, color, -self.rim)


def _name(canvas: Canvas, scene: Scene, e: int, height: float, taken: list[tuple[float, float, float]]) -> None:
    """Write the name below the body, or above it near the lower wall. taken: (x, y, length) of the names so far."""
    x, y, gap = scene.body.x[e], scene.body.y[e], (scene.shape.bound[e] or POINT) + height
    name = printable(kinds(scene.worlds.layout)[e].replace("_", " "))
    length, y = canvas.length(name, height), y - gap if y - gap > height - scene.room else y + gap
    x = min(max(x, length / 2 - scene.room), scene.room - length / 2)
    if all(abs(y - b) > 1.5 * height or abs(x - a) > (length + other) / 2 for a, b, other in taken):
        canvas.text(x, y, name, height, INK)
        taken.append((x, y, length + height))


def others(scene: Scene) -> list[int]:
    """Return the rows of bodies that neither outlast's own layers draw nor any layer that names them in `shows`."""
    rows = _unknown(scene.worlds.layout, frozenset(scene.shown))
    fixed = {*walls(scene)} if rows and Solid in scene else {}
    living = {*scene.living(Body)} if rows else {}
    return [e for e in rows if e in living and e not in fixed]


def has_size(scene: Scene, e: int) -> bool:
    """Return whether the entity in this row has a shape with a size."""
    shape = scene.shape
    return bool(max(shape.radius[e], shape.half_width[e], shape.half_height[e]) > 0)


def of_kind(scene: Scene, e: int) -> Color:
    """Return the colour of the kind of entity in this row; kinds get colours in the order of their rows."""
    layout = scene.worlds.layout
    return KINDS[own_kinds(layout).index(kinds(layout)[e]) % len(KINDS)]


@functools.lru_cache(maxsize=64)
def _unknown(layout: Layout, shown: frozenset[type[Component]]) -> list[int]:
    """Return rows of bodies, in the world or not, that have no component by which some layer shows them."""
    known = {e for component in shown.union(KNOWN) for e in layout.rows(component).tolist()}
    return [e for e in layout.rows(Body).tolist() if e not in known]


@functools.lru_cache(maxsize=64)
def kinds(layout: Layout) -> tuple[str, ...]:
    """Return the name of the kind of each row."""
    return tuple(kind for kind, span in layout.spans.items() for _ in span)


@functools.lru_cache(maxsize=64)
def own_kinds(layout: Layout) -> tuple[str, ...]:
    """Return the kinds without a component that outlast's own layers draw."""
    known = {e for component in KNOWN for e in layout.rows(component).tolist()}
    return tuple(kind for kind, span in layout.spans.items() if not known.intersection(span))
