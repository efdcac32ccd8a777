"""Numbers of agents, on their discs."""

from dataclasses import dataclass

from outlast.components import Body, Shape, Side

from ..canvas import Canvas
from ..scene import Scene
from .palette import ink_on, of_side
from .view import Layer, View


@dataclass(frozen=True)
class Ids(View):
    """The number of every living agent, where it can be read."""

    layer = Layer.AGENTS + 1
    needs = (Side,)
    height: float = 1.15  # of a digit, in radii

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """In black or white, whatever is easier to read on the disc."""
        alive = set(scene.living(Body, Shape, Side))
        for i, e in enumerate(scene.rows(Side)):
            if e in alive:
                ink = ink_on(of_side(scene[Side].side[e]))
                canvas.text(scene.body.x[e], scene.body.y[e], str(i), self.height * scene.shape.radius[e], ink)
