"""The safe zone: a clear disc on a darkened floor, and a dashed circle where it moves to."""

from dataclasses import dataclass

from outlast.components import Floor, Zone

from ..canvas import Canvas
from ..scene import Scene
from ..style import FLOOR, RIM, SIZES, UNSAFE
from .layer import Layer, ZOrder


@dataclass(frozen=True)
class SafeZoneLayer(Layer):
    """The present safe circle and the next one."""

    zorder = ZOrder.ZONE
    needs = (Zone, Floor)
    rim: float = SIZES.zone_rim  # width of the disc's rim, and of dashes
    dash: float = SIZES.zone_dash

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        """Draw both; a void zone has no disc, and a cross marks where the zone is about to vanish."""
        zone, (half_width, half_height) = scene[Zone], scene.sides
        x, y, radius = zone.x[0], zone.y[0], zone.radius[0]
        canvas.rectangle(-half_width, -half_height, half_width, half_height, UNSAFE)
        if radius <= 0:
            return
        canvas.circle(x, y, radius, RIM)
        canvas.circle(x, y, radius - self.rim, FLOOR)
        x, y, radius = zone.next_x[0], zone.next_y[0], zone.next_radius[0]
        if radius > 0:
            canvas.dashes(x, y, radius, RIM, self.rim, self.dash)
        else:
            canvas.segment(x - self.dash, y - self.dash, x + self.dash, y + self.dash, RIM, self.rim)
            canvas.segment(x - self.dash, y + self.dash, x + self.dash, y - self.dash, RIM, self.rim)
