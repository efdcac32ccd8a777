"""Data sets: the samples of a recording in files that others read."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from outlast.ecs import Observation

from ..errors import RecordingError
from ..spaces import published
from ..state import identity
from .replay import Replay
from .samples import Samples, Wish, joined, samples

SHARD = 2**26  # bytes of samples that are kept in memory, and written together
MINARI = "minari:"

ABOUT = {
    "world": "number of the world in the recorded environment",
    "episode": "number of the world's episode, from 1",
    "tick": "steps of this episode before this one",
    "alive": "whether the agent lives, with the observation",
    "actions": "what the agent does, as env.step takes it",
    "rewards": "of this step",
    "terminated": "the episode of the world ends with this step, by its rule",
    "truncated": "the episode of the world ends with this step, by the time limit",
    "last": "the last sample of this episode: it ended, or was reset, or the recording ends",
}


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
    from .shards import export as to_shards

    return to_shards(target, replay, wish)


def manifest(replay: Replay) -> dict[str, Any]:
    """What the samples are: JSON-able."""
    worlds, header = replay.worlds, replay.recording.header
    shapes = {key: list(c.row_shape(name, worlds.dims)[1:]) for key, c, name, _ in published(worlds, Observation)}
    return {
        "format": "outlast samples 1",
        "outlast": header["outlast"],
        "scenario": identity(replay.recording.scenario),
        "mechanics": header["modules"],
        "agents": replay.recording.num_agents,
        "actions": [{"name": name, "size": size} for name, _, size in header["actions"]],
        "observations": shapes,
        "columns": ABOUT,
    }


def batches(replay: Replay, wish: Wish) -> Iterator[Samples]:
    """Samples of many runs together, up to SHARD bytes."""
    waiting, size = list[Samples](), 0
    for each in samples(replay, wish):
        waiting.append(each)
        size += each.nbytes
        if size >= SHARD:
            yield joined(waiting)
            waiting, size = [], 0
    if waiting:
        yield joined(waiting)
