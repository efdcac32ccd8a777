"""Data sets: the samples of a recording in files that others read."""

from pathlib import Path

from ..errors import RecordingError
from ..recording.replay import Replay
from .samples import Wish

MINARI = "minari:"


def write(path: str, replay: Replay, wish: Wish) -> int:
    """Write the wanted samples; returns the number of agent-steps.

    path: a folder, for .npz shards and a manifest; NAME.parquet; or minari:NAME-v0. Nothing of that name may be there,
    and nothing is there before all is written. Raises RecordingError, ReplayError.
    """
    try:
        return _write(path, replay, wish)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}; no data set was written") from error
    except ModuleNotFoundError as error:
        raise RecordingError(str(error)) from error


def _write(path: str, replay: Replay, wish: Wish) -> int:
    if path.startswith(MINARI):
        from .minari import export  # each where it is needed, as their libraries are optional

        return export(path.removeprefix(MINARI), replay, wish)
    target = Path(path)
    if target.exists():
        raise RecordingError(f"{path} exists; a data set overwrites nothing: give another name, or delete it")
    if target.suffix == ".parquet":
        from .parquet import export as to_parquet

        return to_parquet(target, replay, wish)
    from .npz import export as to_shards

    return to_shards(target, replay, wish)
