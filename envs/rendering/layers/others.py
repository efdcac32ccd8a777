"""Items and bodies of mechanics without a layer of their own, drawn from their components."""

import functools
from dataclasses import dataclass

from outlast.components import Body, Box, BoxItem, Heal, Side, Solid
from outlast.ecs import Component, MemoryLayout

from ..canvas import Canvas
from ..scene import Scene
from ..style import FLOOR, INK, KINDS, PAPER, SIZES, Color, mix, of_box
from .captions import margin_line
from .layer import Layer, ZOrder
from .room import walls
from .title import printable

# entities with these are drawn by outlast's own layers, or not at all if those are not shown
KNOWN = (Side, Box, BoxItem, Heal)
POINT = 0.2  # metres: radius with which a body without a size is drawn
DISC, GAP = 1.6, 2.0  # heights of a digit: from the start of a disc to its name, and between entries of a legend
COUNTER = "tick 00000 "  # as long as the step counter, which is beside the legend


@dataclass(frozen=True)
class OthersLayer(Layer):
    """Items and bodies that no other layer shows: their shapes in the colour of their kind.

    A layer that draws entities itself names one of their components in `shows`.
    """

    zorder = ZOrder.ITEMS
    rim: float = SIZES.outline

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw all that are in the world."""
        for e in others(scene):
            self._draw(canvas, scene, e)

    def _draw(self, canvas: Canvas, scene: Scene, e: int) -> None:
        body, color = scene.body, tinted(scene, e, of_kind(scene, e))
        if not has_size(scene, e):
            canvas.circle(body.x[e], body.y[e], POINT, mix(color, INK, 0.6))
            canvas.circle(body.x[e], body.y[e], POINT - self.rim, color)
            return
        canvas.body(scene, e, mix(color, INK, 0.6))
        if scene.least_half(e) > 2 * self.rim:
            canvas.body(scene, e, color, -self.rim)


def tinted(scene: Scene, e: int, color: Color) -> Color:
    """Return the colour of an entity: that of the side that its look names, or else `color`."""
    side = scene.looked_up(e, "tint")
    return color if side < 0 else of_box(int(side))


@dataclass(frozen=True)
class LooksLayer(Layer):
    """The rings and lines that looks name."""

    zorder = ZOrder.STRIKES
    width: float = 2 * SIZES.sight_line

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw them below agents."""
        body, living = scene.body, {*scene.living(Body)}
        for e in sorted(scene.looks.keys() & living):
            if scene.looked_up(e, "ring") > 0:
                canvas.circle(body.x[e], body.y[e], scene.shape.bound[e] + 2 * self.width, INK)
                canvas.circle(body.x[e], body.y[e], scene.shape.bound[e] + self.width, FLOOR)
            if (o := int(scene.looked_up(e, "line_to"))) in living:
                canvas.segment(body.x[e], body.y[e], body.x[o], body.y[o], INK, self.width)


@dataclass(frozen=True)
class LegendLayer(Layer):
    """The names of the kinds that OthersLayer draws, above the room, if there is room for text.

    All kinds are named, in the world or not, so that nothing moves, and as many as fit.
    """

    zorder = ZOrder.WORDS

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw discs and names, which end at the room's right edge."""
        named = _named(scene)
        if not named or (place := margin_line(canvas, scene, 1)) is None:
            return
        y, height = place
        left, x = canvas.length(COUNTER, height) - scene.room, scene.room + GAP * height
        for name, color in reversed(named.items()):
            words = printable(name.replace("_", " "))
            x -= canvas.length(words, height) + (GAP + DISC) * height
            if x < left:
                return
            canvas.circle(x + height / 2, y, height / 2, color)
            canvas.text(x + DISC * height, y, words, height, PAPER, anchor=0)


def _named(scene: Scene) -> dict[str, Color]:
    """Return the colours of the kinds that OthersLayer draws, by name, in the order of their rows."""
    rows = _unknown(scene.worlds.layout, frozenset(scene.shown))
    fixed = {*walls(scene, living=False)} if rows and Solid in scene else {}
    return {kinds(scene.worlds.layout)[e]: of_kind(scene, e) for e in rows if e not in fixed}


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
    """Return the colour of the kind of this row: that of its look, or else one by the order of kinds."""
    layout = scene.worlds.layout
    if e in scene.looks and (color := scene.looks[e].color):
        return color
    return KINDS[own_kinds(layout).index(kinds(layout)[e]) % len(KINDS)]


@functools.lru_cache(maxsize=64)
def _unknown(layout: MemoryLayout, shown: frozenset[type[Component]]) -> list[int]:
    """Return rows of bodies, in the world or not, that have no component by which some layer shows them."""
    known = {e for component in shown.union(KNOWN) for e in layout.rows(component).tolist()}
    return [e for e in layout.rows(Body).tolist() if e not in known]


@functools.lru_cache(maxsize=64)
def kinds(layout: MemoryLayout) -> tuple[str, ...]:
    """Return the name of the kind of each row."""
    return tuple(kind for kind, span in layout.spans.items() for _ in span)


@functools.lru_cache(maxsize=64)
def own_kinds(layout: MemoryLayout) -> tuple[str, ...]:
    """Return the kinds without a component that outlast's own layers draw."""
    known = {e for component in KNOWN for e in layout.rows(component).tolist()}
    return tuple(kind for kind, span in layout.spans.items() if not known.intersection(span))
