"""The start of a tick: it advances clocks, loads the initial state of an episode, and sets rows to 0."""

from typing import Any

import numpy as np

from ..declarations.event import clear
from ..kernels.jit import kernel

SKIP, STEP, RESET = 0, 1, 2  # modes of a world in a tick
EPISODE, TICK, CLOCK_SIZE = 2, 3, 4  # two words of the Clock, and its size in words; a world's state begins with it


@kernel
def advance_clock(world: Any, initial_image: Any, event_counts: Any, mode: int, kept: int) -> None:
    """Count a tick, or start an episode, and forget the events of the previous tick.

    world: the world's state as uint64, like initial_image. event_counts: see ecs.event.clear. kept: how many words at
    the beginning of the state outlast an episode.
    """
    clear(event_counts)
    if mode == RESET:
        world[EPISODE] += np.uint64(1)
        world[TICK] = np.uint64(0)
        load_initial_state(world, initial_image, kept)
    else:
        world[TICK] += np.uint64(1)


@kernel
def load_initial_state(world: Any, initial_image: Any, kept: int) -> None:
    """Set the state, except the words that are kept, to what it is at the start of an episode."""
    for k in range(kept, initial_image.size):
        world[k] = initial_image[k]


@kernel
def zero(rows: Any) -> None:
    """Set all entries of some arrays to 0."""
    for row in rows:
        for k in range(row.size):
            row[k] = 0
