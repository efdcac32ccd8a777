"""Layers: one file a mechanic, as in systems/. A layer reads the tables of one world and draws on a canvas.

@dataclass(frozen=True)
class MarshLayer(Layer):
    zorder = ZOrder.ZONE + 1
    needs = (Swamp,)

    def draw(self, canvas: Canvas, scene: Scene) -> None:
        canvas.circle(0, 0, scene.mechanic(Swamp).radius, (120, 140, 90))

image = draw(env.worlds, 0, layers=[*LAYERS, MarshLayer(), CamerasLayer()])
"""

from outlast.ecs.errors import did_you_mean

from ...errors import FilmError
from ..scene import Scene
from .agents import AgentsLayer, IdsLayer
from .boxes import BoxesLayer, BoxItemsLayer
from .cameras import CamerasLayer
from .captions import FeedStrip, KillFeedLayer, StepCounterLayer
from .end import EndLayer
from .heals import HealsLayer
from .health import HealthBarsLayer
from .inventory import InventoryLayer
from .layer import Layer, Strip, ZOrder
from .lidar import LidarLayer
from .melee import HitsLayer, MeleeLayer
from .others import OthersLayer
from .room import RoomLayer, WallsLayer
from .scores import ScoresStrip
from .title import TitleStrip
from .zone import SafeZoneLayer

__all__ = [
    "FILM_LAYERS",
    "FILM_LAYERS_BY_NAME",
    "FILM_OPTIONAL",
    "LAYERS",
    "LAYERS_BY_NAME",
    "OPTIONAL",
    "AgentsLayer",
    "BoxItemsLayer",
    "BoxesLayer",
    "CamerasLayer",
    "EndLayer",
    "FeedStrip",
    "HealsLayer",
    "HealthBarsLayer",
    "HitsLayer",
    "IdsLayer",
    "InventoryLayer",
    "KillFeedLayer",
    "Layer",
    "LidarLayer",
    "MeleeLayer",
    "OthersLayer",
    "RoomLayer",
    "SafeZoneLayer",
    "Scene",
    "ScoresStrip",
    "StepCounterLayer",
    "Strip",
    "TitleStrip",
    "WallsLayer",
    "ZOrder",
    "select",
]

LAYERS_BY_NAME: dict[str, Layer] = {
    "room": RoomLayer(),
    "zone": SafeZoneLayer(),
    "vision": CamerasLayer(lines=False),
    "lines": CamerasLayer(cones=False),
    "lidar": LidarLayer(),
    "heals": HealsLayer(),
    "items": BoxItemsLayer(),
    "others": OthersLayer(),
    "boxes": BoxesLayer(),
    "walls": WallsLayer(),
    "melee": MeleeLayer(),
    "agents": AgentsLayer(),
    "ids": IdsLayer(),
    "hits": HitsLayer(),
    "health": HealthBarsLayer(),
    "inventory": InventoryLayer(),
    "steps": StepCounterLayer(),
    "feed": KillFeedLayer(),
}
"""Every layer of a picture by its short name."""

OPTIONAL = ("vision", "lines", "lidar")

LAYERS: tuple[Layer, ...] = tuple(layer for name, layer in LAYERS_BY_NAME.items() if name not in OPTIONAL)
"""What is drawn by default."""

FILM_LAYERS_BY_NAME: dict[str, Layer] = {
    "title": TitleStrip(),
    **LAYERS_BY_NAME,
    "end": EndLayer(),
    "feed": FeedStrip(),
    "scores": ScoresStrip(),
}
"""The layers of films, for --views: what a picture has in its margin is beside it, where there is more room."""

FILM_OPTIONAL = (*OPTIONAL, "steps")

FILM_LAYERS: tuple[Layer, ...] = tuple(
    layer for name, layer in FILM_LAYERS_BY_NAME.items() if name not in FILM_OPTIONAL
)
"""What films show by default."""


def select(changes: str) -> tuple[Layer, ...]:
    """FILM_LAYERS with additions and removals, as in "+vision,-ids"; a name without a sign is added.

    Raises:
        FilmError: For an unknown name.
    """
    shown = {name: name not in FILM_OPTIONAL for name in FILM_LAYERS_BY_NAME}
    for change in filter(None, (part.strip() for part in changes.split(","))):
        name = change[1:] if change[0] in "+-" else change
        if name not in FILM_LAYERS_BY_NAME:
            hint = did_you_mean(name, FILM_LAYERS_BY_NAME, after=" ")
            raise FilmError(f"there is no layer '{name}'; {hint}known: {', '.join(FILM_LAYERS_BY_NAME)}")
        shown[name] = change[0] != "-"
    return tuple(layer for name, layer in FILM_LAYERS_BY_NAME.items() if shown[name])
