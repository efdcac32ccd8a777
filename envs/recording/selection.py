"""Which ticks and worlds of a recording are asked for."""

from collections.abc import Iterable
from typing import Any

from outlast.ecs.whole import is_whole

from ..errors import RecordingError
from .reader import Recording


def last_tick(recording: Recording, first: int, last: int | None, worlds: Any) -> int:
    """The number of the last tick that is asked for. Raises RecordingError if there are no such ticks or worlds.

    Args:
        recording: Of which.
        first: Number of the first tick, from 0 on.
        last: Number of the last one; None: the last there is.
        worlds: Numbers of worlds, in a sequence; None: all.
    """
    given: list[Any] = [first, 0 if last is None else last]
    if strange := [tick for tick in given if not is_whole(tick)]:
        raise RecordingError(f"tick {strange[0]!r}: whole numbers are needed, counted from 0")
    if not len(recording):
        raise RecordingError(f"{recording.path}: there is no tick in it")
    most = len(recording) - 1
    end = most if last is None else last
    if not 0 <= first <= end <= most:
        raise RecordingError(
            f"ticks {first} to {end}: 0 <= from <= to <= {most} is needed, the last tick of {recording.path}"
        )
    if worlds is not None and not isinstance(worlds, Iterable):
        raise RecordingError(f"worlds = {worlds!r}: their numbers are needed, as in [0, 3]")
    if odd := [w for w in worlds or () if not is_whole(w)]:
        raise RecordingError(f"world {odd[0]!r}: whole numbers are needed, counted from 0")
    if worlds is not None and (unknown := [w for w in worlds if not 0 <= w < recording.num_worlds]):
        raise RecordingError(
            f"{recording.path}: there is no world {unknown[0]}; they are 0 to {recording.num_worlds - 1}"
        )
    return end
