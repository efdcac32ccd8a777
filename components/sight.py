"""What each agent sees."""

from typing import Any

from outlast.ecs import Array, Singleton, column, kernel

MASKED, REVEALED, OMNISCIENT = 0, 1, 2
MODES = ("masked", "revealed", "omniscient")


class Sight(Singleton):
    """Who sees whom, by observer and row. Written by cameras; without cameras everybody sees everything."""

    seen: Array = column("u1", "agents", "rows")
    mode: Array = column("i4", fill=OMNISCIENT)  # index into MODES


@kernel
def look(sight: Any, entities: Any, i: int, me: int, e: int) -> tuple[int, int]:
    """(mask, shown) of entity `e` for observer number `i` in row `me`: what the mask says, and if its row is filled.

    masked: both only for what the camera sees. revealed: the camera masks, rows of all that exists are filled.
    omniscient: all that exists has both. A dead observer's masks are 0.
    """
    here, awake, mode = entities.alive[e], entities.alive[me], sight.mode[0]
    if mode == OMNISCIENT:
        return here & awake, here
    mask = sight.seen[i, e] & here & awake
    return mask, (mask if mode == MASKED else here)
