"""Layers of pictures and films: those of outlast, and what layers of one's own are made of.

>>> from outlast.drawing import Canvas, Layer, Scene, ZOrder

A layer is a class with a method `draw(self, canvas, scene)`: it reads one world and draws on a canvas, in metres.
`outlast.draw`, `outlast.film` and --views take instances.
"""

from .envs.rendering.canvas import Canvas
from .envs.rendering.layers import (
    FILM_LAYERS,
    LAYERS,
    AgentsLayer,
    BoxesLayer,
    BoxItemsLayer,
    CamerasLayer,
    EndLayer,
    FeedStrip,
    HealsLayer,
    HealthBarsLayer,
    HitsLayer,
    IdsLayer,
    InventoryLayer,
    KillFeedLayer,
    Layer,
    LegendLayer,
    LidarLayer,
    LooksLayer,
    MeleeLayer,
    OthersLayer,
    RoomLayer,
    SafeZoneLayer,
    Scene,
    ScoresStrip,
    StepCounterLayer,
    Strip,
    TitleStrip,
    WallsLayer,
    ZOrder,
    select,
)
from .envs.rendering.rgb import text
from .envs.rendering.style import FLOOR, INK, PAPER, WALL, mix, of_side
from .envs.rendering.video import footage, write_film

__all__ = [
    "FILM_LAYERS",
    "FLOOR",
    "INK",
    "LAYERS",
    "PAPER",
    "WALL",
    "AgentsLayer",
    "BoxItemsLayer",
    "BoxesLayer",
    "CamerasLayer",
    "Canvas",
    "EndLayer",
    "FeedStrip",
    "HealsLayer",
    "HealthBarsLayer",
    "HitsLayer",
    "IdsLayer",
    "InventoryLayer",
    "KillFeedLayer",
    "Layer",
    "LegendLayer",
    "LidarLayer",
    "LooksLayer",
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
    "footage",
    "mix",
    "of_side",
    "select",
    "text",
    "write_film",
]
