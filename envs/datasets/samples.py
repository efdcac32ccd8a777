"""Samples: what a learner wants of a recording, made by replaying it.

A sample is a step that a world took, for all of its agents: the observation before the step, the actions, and the
rewards and ends that came of them. Runs of the tick that only reset a world are no samples. The observation after a
step is that of the world's next sample; after the last one of an episode it is `final`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import End, Reward
from outlast.ecs import RESET, STEP, Clock, Observation, Worlds

from ..core.agents import alive
from ..core.spaces import published
from ..recording.reader import Recording
from ..recording.replay import Replay

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Wish:
    """Which samples are wanted: of the worlds `chosen`, from the run `first` to the run `last`.

    verify: compare digests. progress: called with the number of each run that is done.
    """

    chosen: Sequence[int]
    first: int
    last: int
    verify: bool = True
    progress: Callable[[int], None] = lambda run: None


@dataclass(frozen=True)
class Samples:
    """The samples of one run of the tick, n of them in order of worlds.

    columns: by name, (n, ...): world, its number in the recorded environment. episode, the world's, from 1. tick, steps
    of this episode before. alive, bool (n, agents), with the observation. actions (n, agents, actions), as env.step
    takes them. rewards, float32 (n, agents). terminated, truncated, bool (n,), the world's. last, bool (n,): this
    episode has no next sample, as it ended, or was reset, or the recording ends.
    observations: by key, float32 (n, agents, ...). final: the same after the step, a row for each that is `last`.
    """

    columns: dict[str, Array]
    observations: dict[str, Array]
    final: dict[str, Array]

    def __len__(self) -> int:
        return len(self.columns["world"])

    def row(self, k: int, final: int | None) -> "Samples":
        """Sample k alone. final: its row of `final`, if it is the last of its episode."""
        own = slice(0, 0) if final is None else slice(final, final + 1)
        columns, observations = (
            {key: array[k : k + 1] for key, array in part.items()} for part in (self.columns, self.observations)
        )
        return Samples(columns, observations, {key: array[own] for key, array in self.final.items()})

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for part in (self.columns, self.observations, self.final) for array in part.values())


def joined(parts: list[Samples]) -> Samples:
    """The samples of `parts`, one behind the other."""

    def together(tables: Iterable[dict[str, Array]]) -> dict[str, Array]:
        listed = list(tables)
        return {key: np.concatenate([table[key] for table in listed]) for key in listed[0]}

    return Samples(
        together(part.columns for part in parts),
        together(part.observations for part in parts),
        together(part.final for part in parts),
    )


def samples(replay: Replay, wish: Wish) -> Iterator[Samples]:
    """The samples of a recording, run by run; runs without any are left out. Raises ReplayError, RecordingError."""
    worlds, ends = replay.worlds, _ends(replay.recording, wish)
    buffers = {key: getattr(worlds[c], name) for key, c, name, _ in published(worlds, Observation)}
    chosen = np.zeros(worlds.count, bool)
    chosen[list(wish.chosen)] = True
    before: dict[str, Array] = {}
    living = np.zeros(0, bool)
    for number in replay.ticks(wish.verify):
        rows = np.flatnonzero(chosen & (worlds.mode == STEP))
        if number >= wish.first and rows.size:
            last = np.isin(rows, ends.get(number, ()))
            observations = {key: before[key][rows] for key in buffers}
            final = {key: buffer[rows[last]] for key, buffer in buffers.items()}
            yield Samples(_columns(replay, rows, living[rows], last), observations, final)
        wish.progress(number)
        if number >= wish.last:
            return
        before = {key: buffer.copy() for key, buffer in buffers.items()}
        living = alive(worlds)


def _columns(replay: Replay, rows: Array, alive: Array, last: Array) -> dict[str, Array]:
    worlds, end = replay.worlds, replay.worlds[End]
    clock = worlds[Clock]
    return {
        "world": rows + replay.recording.first_world,
        "episode": clock.episode[rows, 0].astype(np.int64),
        "tick": clock.tick[rows, 0].astype(np.int64) - 1,
        "alive": alive,
        "actions": _actions(worlds, replay.recording, rows),
        "rewards": worlds[Reward].reward[rows],
        "terminated": end.terminated[rows, 0],
        "truncated": end.truncated[rows, 0],
        "last": last,
    }


def _actions(worlds: Worlds, recording: Recording, rows: Array) -> Array:
    """Integers (n, agents, actions) from 0, in the smallest type that holds them."""
    columns = recording.header["actions"]
    lows = np.array([low for _, low, _ in columns], np.int64)
    kind = np.min_scalar_type(-max((size for _, _, size in columns), default=1))
    actions: Array = (worlds.actions[:, rows].transpose(1, 2, 0) - lows).astype(kind)
    return actions


def _ends(recording: Recording, wish: Wish) -> dict[int, list[int]]:
    """For each run that is the last step of some worlds before a reset, or before the end: these worlds."""
    latest, ends = np.full(recording.num_worlds, -1), dict[int, list[int]]()

    def note(rows: Array) -> None:
        for w in rows:
            ends.setdefault(int(latest[w]), []).append(int(w))

    for number, run in enumerate(recording.runs()):
        if number > wish.last:
            break
        note(np.flatnonzero((run.mode == RESET) & (latest >= 0)))
        latest[run.mode == RESET] = -1
        latest[run.mode == STEP] = number
    note(np.flatnonzero(latest >= 0))
    return ends
