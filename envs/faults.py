"""Worlds that cannot go on."""

from outlast.components import Fault
from outlast.ecs import Worlds

from .errors import FaultError


def check_faults(worlds: Worlds) -> None:
    """FaultError if a body of some world got a number that physics cannot take."""
    if Fault in worlds and worlds[Fault].physics.any():
        w = int(worlds[Fault].physics[:, 0].argmax())
        raise FaultError(
            f"world {w}: a body has a position, speed or size that physics cannot take (NaN, or 1e6 and more); "
            "some mechanic wrote it into Body or Shape. Reset the world: it starts afresh"
        )
