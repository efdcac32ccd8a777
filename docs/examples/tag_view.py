"""How tag looks: the base is a green disc, a red ring marks who is it, a blue one who is safe, and shields are blue."""

from dataclasses import dataclass

from tag import Player, Shield, Tag

from outlast.drawing import LAYERS, Canvas, HealthBarsLayer, Layer, Scene, ZOrder

GREEN, RED, BLUE = (150, 200, 150), (220, 50, 40), (90, 140, 230)


@dataclass(frozen=True)
class BaseLayer(Layer):
    """The safe circle, on the ground."""

    zorder = ZOrder.ZONE
    needs = (Tag,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """In metres, as everything."""
        canvas.circle(0, 0, scene.mechanic(Tag).base, GREEN)


@dataclass(frozen=True)
class PlayersLayer(Layer):
    """A ring around who is it or safe, below the agents; shields on the ground."""

    zorder = ZOrder.ITEMS
    needs = (Player,)
    shows = (Shield,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Shields only where there are some."""
        body, radius, player = scene.body, scene.shape.radius, scene[Player]
        for e in scene.living(Shield) if Shield in scene else ():
            canvas.circle(body.x[e], body.y[e], radius[e], BLUE)
        for e in scene.living(Player):
            if player.it[e] or player.safe[e]:
                canvas.circle(body.x[e], body.y[e], radius[e] + 0.2, RED if player.it[e] else BLUE)


TAG_LAYERS = [layer for layer in LAYERS if not isinstance(layer, HealthBarsLayer)] + [BaseLayer(), PlayersLayer()]
