"""How poison looks in pictures and videos: vials are green discs, and ill agents have a green ring."""

from dataclasses import dataclass

from poison import Illness, Vial

from outlast.drawing import Canvas, Layer, Scene, ZOrder

GREEN = (110, 190, 40)


@dataclass(frozen=True)
class PoisonLayer(Layer):
    """Vials on the ground, and a ring around each ill agent."""

    zorder = ZOrder.ITEMS
    needs = (Vial, Illness)
    shows = (Vial,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Positions and sizes are in metres."""
        body, shape = scene.body, scene.shape
        for e in scene.living(Vial):
            canvas.circle(body.x[e], body.y[e], shape.radius[e], GREEN)
        for e in scene.living(Illness):
            if scene[Illness].left[e] > 0:
                canvas.circle(body.x[e], body.y[e], shape.radius[e] + 0.3, GREEN, width=0.15)
