"""Worlds that cannot begin, or cannot go on."""

from typing import Any

import numpy as np

from outlast.components import End, Fault, Reward
from outlast.ecs import Worlds

from .errors import FaultError, NotResetError
from .scenario import ScenarioError

Array = np.ndarray[Any, Any]


def check_playable(worlds: Worlds, name: str) -> None:
    """ScenarioError unless the worlds of the scenario of that name tell rewards and ends."""
    if missing := [signal.__name__ for signal in (Reward, End) if signal not in worlds]:
        raise ScenarioError(
            f"{name}: no module brings {' and '.join(missing)}; an environment needs the modules rewards and ending"
        )


def check_faults(worlds: Worlds) -> None:
    """FaultError if a body of some world got a number that physics cannot take."""
    if Fault in worlds and worlds[Fault].physics.any():
        w = int(worlds[Fault].physics[:, 0].argmax())
        raise FaultError(
            f"world {w}: a body has a position, speed or size that physics cannot take (NaN, or 1e6 and more); "
            "some mechanic wrote it into Body or Shape. Reset the world: it starts afresh"
        )


def check_steppable(started: Array, waiting: Array) -> None:
    """NotResetError unless all worlds have started, and none has ended and waits for its reset. Masks (worlds,)."""
    if not started.all():
        raise NotResetError(f"step() before reset(): {int((~started).sum())} worlds have not started; reset them")
    if waiting.any():
        raise NotResetError(
            f"worlds {np.flatnonzero(waiting)[:8].tolist()} have ended and autoreset is disabled; "
            'reset them first: reset(options={"reset_mask": terminated | truncated})'
        )
