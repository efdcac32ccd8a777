"""The tick: its phases, in the order of the paper's experiments, and its length."""

from typing import Annotated, TypeAlias

import numpy as np

from outlast import ecs
from outlast.ecs import Real, Service, When


class Phase(ecs.PhaseBase):
    """The order of a tick; each phase has a postcondition.

    Phases with When.RESET or When.ALWAYS also run in the tick that starts an episode.
    """

    DRAW = When.RESET, "what is random in an episode is drawn"
    SPAWN = When.RESET, "every body stands on a cell of its own"
    RESPAWN = When.STEP, "what broke in the tick before lies on the ground as an item"
    DRIVE = When.STEP, "motors have pushed"
    USE = When.STEP, "used items have left their bags"
    EFFECT = When.STEP, "used items have had their effect"
    GIVE = When.STEP, "items have changed hands"
    MELEE = When.STEP, "attacks have landed; no entity is removed yet"
    MOVE = When.STEP, "bodies have moved and contacts are resolved"
    BREAK = When.STEP, "objects without health are gone"
    SEE = When.ALWAYS, "visibility is known"
    DIE = When.STEP, "agents without health are gone and their items are dropped"
    PICKUP = When.STEP, "items in reach are in bags"
    ZONE = When.STEP, "who was outside of the safe zone is hurt, and the zone has moved on"
    LOOK = When.ALWAYS, "observation masks are computed"
    OBSERVE = When.ALWAYS, "observations show the world as it is"
    REWARD = When.ALWAYS, "rewards are paid"
    END = When.ALWAYS, "terminated and truncated are known"
    RECORD = When.STEP, "the statistics of the episode are up to date"

    # the same phases by names without hit points, items and zones
    RETURN = RESPAWN
    CHOOSE = USE
    ACT = EFFECT
    EXCHANGE = GIVE
    INTERACT = MELEE
    AFTER_MOVE = BREAK
    REMOVE = DIE
    COLLECT = PICKUP
    SURROUND = ZONE


def tick_length(physics_rate: float, physics_substeps: int) -> Real:
    """Return the length of a tick, float32 seconds."""
    return np.float32(physics_substeps / physics_rate)


Seconds: TypeAlias = Annotated[Real, Service(tick_length)]
"""A parameter of systems: the length of a tick in seconds, float32. It is computed from two numbers of `Physics`."""
