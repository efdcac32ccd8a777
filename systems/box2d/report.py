"""The event Touch, from the touches that a contact batch has recorded."""

from typing import Any

import numpy as np

from outlast.ecs import Array, emit, kernel

from .batch import AT_X, AT_Y, HIGH, IMPULSE, LOW


@kernel
def report_touches(touches: Array, rows: Array, events: Any, last: Any) -> None:
    """Emit an event for each pair, in order of rows, and store the pairs.

    touches: see `batch`. rows: the row of each position in the batch. last: the pairs of the previous tick.
    """
    count, known = int(touches[0, LOW]), last.count[0]
    k = 0
    for n in range(count):
        i = emit(events)
        e, o = rows[int(touches[n + 1, LOW])], rows[int(touches[n + 1, HIGH])]
        while k < known and (last.solid[k] < e or (last.solid[k] == e and last.other[k] < o)):
            k += 1
        events.solid[i], events.other[i], events.impulse[i] = e, o, touches[n + 1, IMPULSE]
        events.x[i], events.y[i] = touches[n + 1, AT_X], touches[n + 1, AT_Y]
        events.began[i] = not (k < known and last.solid[k] == e and last.other[k] == o)
    for i in range(count):
        last.solid[i], last.other[i] = events.solid[i], events.other[i]
    for i in range(count, known):
        last.solid[i], last.other[i] = 0, 0
    last.count[0] = np.int32(count)


@kernel
def report_nothing(last: Any) -> None:
    """Store that nothing touches."""
    for i in range(last.count[0]):
        last.solid[i], last.other[i] = 0, 0
    last.count[0] = 0
