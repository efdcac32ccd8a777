"""Samples: the transitions of a recording, made by replaying it.

A sample is a step of a world, for all of its agents: the observation before the step, the actions, and the resulting
rewards and ends. Ticks that only reset a world are not samples. The observation after a step is in the world's next
sample; after the last step of an episode it is in `final`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import End, Reward
from outlast.ecs import RESET, STEP, Clock, Observation

from ..core.spaces import alive, counts_vary, present, published
from ..core.validation import Array, joined
from ..errors import RecordingError
from ..recording import Recording, Replay
from ..scenarios.fingerprint import fingerprint

SHARD_BYTES = 2**26  # approximate bytes of samples kept in memory and written together
COLUMNS = {
    "world": "number of the world in the recorded environment",
    "episode": "number of the world's episode in this recording, from 1",
    "tick": "steps of this episode before this one",
    "present": "whether the episode has the agent; only where the number of agents varies",
    "alive": "whether the agent lives, with the observation",
    "actions": "what the agent does: an integer for each of the game's actions, for any form that env.step took",
    "rewards": "of this step",
    "terminated": "the episode of the world ends with this step, by its rule",
    "truncated": "the episode of the world ends with this step, by the time limit",
    "last": "the last sample of this episode: it ended, or was reset, or the recording ends",
}


@dataclass(frozen=True)
class Selection:
    """Samples to export."""

    worlds: Sequence[int]
    first: int  # tick
    last: int
    verify: bool = True  # whether to compare digests
    progress: Callable[[int], None] = lambda tick: None  # called with the number of each replayed tick


@dataclass(frozen=True)
class DatasetSamples:
    """n samples of one tick, in order of worlds, or of several ticks.

    columns: by name, see COLUMNS: alive and present are bool (n, agents), actions (n, agents, actions), rewards float32
    (n, agents), the others (n,).
    observations: by key, float32 (n, agents, ...). final: the same after the step, a row for each that is `last`.
    """

    columns: dict[str, Array]
    observations: dict[str, Array]
    final: dict[str, Array]

    def __len__(self) -> int:
        return len(self.columns["world"])

    def row(self, k: int) -> "DatasetSamples":
        """Return sample k alone."""
        last = self.columns["last"]
        final = last[:k].sum()
        own = slice(k, k + 1), slice(k, k + 1), slice(final, final + last[k])
        parts = zip((self.columns, self.observations, self.final), own, strict=True)
        return DatasetSamples(*({key: array[rows] for key, array in part.items()} for part, rows in parts))

    @property
    def present(self) -> Array:
        """Return whether the episode has the agent, bool (n, agents)."""
        return self.columns.get("present", np.ones_like(self.columns["alive"]))

    @property
    def nbytes(self) -> int:
        """The size of all arrays in bytes."""
        return sum(array.nbytes for part in (self.columns, self.observations, self.final) for array in part.values())


def concatenate(parts: list[DatasetSamples]) -> DatasetSamples:
    """Join the samples of `parts`."""
    tables = [(part.columns, part.observations, part.final) for part in parts]
    return DatasetSamples(*map(joined, zip(*tables, strict=True)))


def read_samples(replay: Replay, selection: Selection) -> Iterator[DatasetSamples]:
    """Yield the samples of a recording, tick by tick; ticks without any are left out. Raises RecordingError."""
    worlds, last_steps = replay.worlds, _last_steps(replay.recording, selection)
    buffers = {key: getattr(worlds[c], name) for key, c, name, _ in published(worlds, Observation)}
    selected = np.zeros(worlds.count, bool)
    selected[list(selection.worlds)] = True
    before: dict[str, Array] = {}
    living, found = np.zeros(0, bool), False
    for number in replay.ticks(selection.verify, last=selection.last):
        rows = np.flatnonzero(selected & (worlds.mode == STEP))
        if number >= selection.first and rows.size:
            found, last = True, np.isin(rows, last_steps.get(number, ()))
            observations = {key: before[key][rows] for key in buffers}
            final = {key: buffer[rows[last]] for key, buffer in buffers.items()}
            yield DatasetSamples(_columns(replay, rows, living[rows], last), observations, final)
        selection.progress(number)
        before = {key: buffer.copy() for key, buffer in buffers.items()}
        living = alive(worlds)
    if not found:
        raise RecordingError(
            f"{replay.recording.path}: none of the worlds asked for takes a step in the ticks {selection.first} to "
            f"{selection.last}, so samples are empty; tick 0 resets all worlds"
        )


def _columns(replay: Replay, rows: Array, living: Array, last: Array) -> dict[str, Array]:
    worlds, end, actions = replay.worlds, replay.worlds[End], replay.recording.header["actions"]
    lows = np.array([low for _, low, _ in actions], np.int64)
    kind = np.min_scalar_type(-max((size for *_, size in actions), default=1))  # the smallest that holds 0 to size
    return ({"present": present(worlds, rows)} if counts_vary(worlds) else {}) | {
        "world": rows + replay.recording.first_world,
        "episode": replay.episodes[rows],
        "tick": worlds[Clock].tick[rows, 0].astype(np.int64) - 1,
        "alive": living,
        "actions": (worlds.actions[:, rows].transpose(1, 2, 0) - lows).astype(kind),
        "rewards": worlds[Reward].reward[rows],
        "terminated": end.terminated[rows, 0],
        "truncated": end.truncated[rows, 0],
        "last": last,
    }


def _last_steps(recording: Recording, selection: Selection) -> dict[int, list[int]]:
    """Return, by number of the tick, the worlds with their last step before a reset, or before the end, in it."""
    latest, last_steps = np.full(recording.num_worlds, -1), dict[int, list[int]]()

    def note(rows: Array) -> None:
        for w in rows:
            last_steps.setdefault(int(latest[w]), []).append(int(w))

    for number, record in enumerate(recording.tick_records()):
        if number > selection.last:
            break
        note(np.flatnonzero((record.mode == RESET) & (latest >= 0)))
        latest[record.mode == RESET] = -1
        latest[record.mode == STEP] = number
    note(np.flatnonzero(latest >= 0))
    return last_steps


def read_shards(replay: Replay, selection: Selection) -> Iterator[DatasetSamples]:
    """Yield samples of many ticks together, up to SHARD_BYTES."""
    waiting, size = list[DatasetSamples](), 0
    for batch in read_samples(replay, selection):
        waiting.append(batch)
        size += batch.nbytes
        if size >= SHARD_BYTES:
            yield concatenate(waiting)
            waiting, size = [], 0
    if waiting:
        yield concatenate(waiting)


def manifest(replay: Replay) -> dict[str, Any]:
    """Return a description of the samples that can be written as JSON."""
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
        "columns": {key: about for key, about in COLUMNS.items() if key != "present" or counts_vary(worlds)},
    }
