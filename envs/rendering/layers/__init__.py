"""Views: one file a mechanic, as in systems/. A view reads the tables of one world and draws on a canvas.

@dataclass(frozen=True)
class Marsh(View):
    layer = Layer.ZONE + 1
    needs = (Swamp,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        canvas.circle(0, 0, scene.mechanic(Swamp).radius, (120, 140, 90))

image = draw(env.worlds, 0, views=[*VIEWS, Marsh(), Cameras()])
"""

from ..scene import Scene
from .agents import Agents
from .boxes import Boxes, BoxItems
from .cameras import Cameras
from .feed import KillFeed
from .heals import Heals
from .health import HealthBars
from .ids import Ids
from .inventory import Inventory
from .melee import Hits, Melee
from .names import NAMES, VIEWS, select
from .room import Room, Walls
from .steps import StepCounter
from .view import Layer, View
from .zone import SafeZone

__all__ = [
    "NAMES",
    "VIEWS",
    "Agents",
    "BoxItems",
    "Boxes",
    "Cameras",
    "Heals",
    "HealthBars",
    "Hits",
    "Ids",
    "Inventory",
    "KillFeed",
    "Layer",
    "Melee",
    "Room",
    "SafeZone",
    "Scene",
    "StepCounter",
    "View",
    "Walls",
    "select",
]
