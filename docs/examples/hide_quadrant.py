"""Hide and seek in a quadrant: doors drawn for every episode, two boxes, and a ramp over a low wall."""

from hide_and_seek import HIDE_AND_SEEK
from quadrant import Quadrant
from ramp import Ramps

from outlast import systems

HIDE_QUADRANT = (
    HIDE_AND_SEEK.without("room", "walls")
    .with_(systems.Room(size=12.0), Quadrant(), Ramps())
    .replace(boxes_count=2, lidar_rays=30)
)
