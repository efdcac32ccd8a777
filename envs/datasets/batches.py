"""Samples of a recording in batches, and what they are: what all formats write."""

from collections.abc import Iterator
from typing import Any

from outlast.ecs import Observation

from ..core.spaces import published
from ..recording.replay import Replay
from ..scenarios.fingerprint import fingerprint
from .samples import Samples, Wish, joined, samples

SHARD = 2**26  # bytes of samples that are kept in memory, and written together

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


def manifest(replay: Replay) -> dict[str, Any]:
    """What the samples are: JSON-able."""
    worlds, header = replay.worlds, replay.recording.header
    shapes = {key: list(c.row_shape(name, worlds.dims)[1:]) for key, c, name, _ in published(worlds, Observation)}
    return {
        "format": "outlast samples 1",
        "outlast": header["outlast"],
        "scenario": fingerprint(replay.recording.scenario),
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
