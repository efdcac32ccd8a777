"""The selection of ticks and worlds of a recording."""

from collections.abc import Iterable
from typing import Any

from outlast.ecs.kernels.integers import is_whole

from ..errors import RecordingError
from .reader import Recording


def last_tick(recording: Recording, first: int, last: int | None) -> int:
    """Return the number of the last tick of a selection. Raises RecordingError if there are no such ticks.

    Args:
        recording: The recording.
        first: Number of the first tick, from 0 on.
        last: Number of the last tick; None: the last of the recording.
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
    return end


def rows_of(recording: Recording, worlds: Any) -> list[int]:
    """Return the rows of these worlds in the tables. Raises RecordingError if there are no such worlds.

    Args:
        recording: The recording.
        worlds: Numbers of worlds as in tables of events and samples: from `first_world` on.
    """
    if not isinstance(worlds, Iterable):
        raise RecordingError(f"worlds = {worlds!r}: their numbers are needed, as in [0, 3]")
    asked, first, last = list(worlds), recording.first_world, recording.first_world + recording.num_worlds - 1
    if odd := [w for w in asked if not is_whole(w)]:
        raise RecordingError(f"world {odd[0]!r}: whole numbers are needed")
    if unknown := [w for w in asked if not first <= w <= last]:
        raise RecordingError(f"{recording.path}: there is no world {unknown[0]}; they are {first} to {last}")
    return [w - first for w in asked]
