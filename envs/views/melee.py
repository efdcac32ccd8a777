"""Strikes of this tick: a bright segment where something was hit, a thin one where nothing was."""

from dataclasses import dataclass

from outlast import systems
from outlast.components import Attack, Body, Shape, Weapon
from outlast.ecs import Clock

from ..canvas import Canvas
from .palette import INK, STRIKE
from .scene import Scene
from .view import Layer, View


@dataclass(frozen=True)
class Melee(View):
    """Who attacked in the last tick, as far as the weapon reaches."""

    layer = Layer.STRIKES
    needs = (Weapon, Attack, systems.Melee)
    width: float = 0.16  # metres

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """From the attacker's place after the tick: it has moved since it struck."""
        if not scene[Clock].tick[0]:
            return  # the actions are those of the episode before
        weapon, alive = scene[Weapon], set(scene.living(Body, Shape, Weapon))
        for i, me in enumerate(scene.rows(Weapon)):
            if me in alive and weapon.target[me] >= 0:
                self._draw(canvas, scene, me, INK, 2 * self.width)
                self._draw(canvas, scene, me, STRIKE, self.width)
            elif me in alive and scene[Attack].attack[i] and not weapon.wait[me]:  # or it waited until just now
                self._draw(canvas, scene, me, INK, self.width / 2)

    def _draw(self, canvas: Canvas, scene: Scene, me: int, color: tuple[int, int, int], width: float) -> None:
        x, y, reach = scene.body.x[me], scene.body.y[me], scene.mechanic(systems.Melee).reach
        canvas.segment(x, y, x + reach * scene.body.cosine[me], y + reach * scene.body.sine[me], color, width)
