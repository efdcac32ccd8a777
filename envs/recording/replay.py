"""Replaying: running the recorded ticks again, and comparing each with its recorded digest."""

import os
from collections.abc import Iterable, Iterator

import numpy as np

from outlast.components import End
from outlast.ecs import RESET, STEP, Clock, EngineError
from outlast.ecs.memory.given import wrongly_given
from outlast.ecs.memory.numbers import GIVEN_WORDS, Given

from ..core.agents import counted
from ..core.lifecycle import announce_compilation, check_playable
from ..core.spaces import statistics
from ..core.validation import Array, check_count
from ..errors import RecordingError, ReplayError, ScenarioError
from ..inspect.event_table import with_episodes
from ..rollout.summary import Summary
from .digests import Digests
from .reader import Recording, last_tick, rows_of
from .tick_records import KEY_SIZE, JointActions, TickRecord


class Replay:
    """The worlds of a recording, in which the recorded ticks are run.

    Attributes:
        recording: The recording.
        worlds: An ecs.Worlds, in the state after the last tick that `ticks` yielded; read its tables and its `mode`.
        summary: The summary of the episodes that have ended so far; once all of them have, it is that which the
            recorded rollout printed. Without the counts in a recording, it is of the first episode of
            each world, once each has ended one.
        episodes: Number of episodes begun in each world so far, int64 (worlds,). A clock's `episode` may differ: it
            starts again when a seed is given, and a level with a key sets it.
        policy: The record of the policy before that tick, policy_record.policy_dtype (worlds, agents), NaN in
            worlds that took no step; None if no policy was recorded.

    Args:
        recording: A recording from `Recording.open`, or the path of a file.
        threads: Number of threads among which the worlds are divided.

    Raises:
        RecordingError: The worlds cannot be made, or their actions or components differ from those recorded.
    """

    def __init__(self, recording: Recording | str | os.PathLike[str], threads: int = 1) -> None:
        recording = recording if isinstance(recording, Recording) else Recording.open(recording)
        check_count("threads", threads, 1)
        self._going: object = None  # marks the newest iterator of `ticks`: older ones must not continue
        self.recording, scenario = recording, recording.scenario
        self._known: int | None = recording.header.get("episodes")
        self._all = self._first = Summary()
        self.policy: Array | None = None
        try:
            self.worlds = scenario.worlds(recording.num_worlds, threads)
            check_playable(self.worlds, scenario.name)
        except (EngineError, ScenarioError, MemoryError) as error:
            raise RecordingError(f"{recording.path}: its worlds cannot be made: {error}") from error
        self.episodes = np.zeros(self.worlds.count, np.int64)
        self._joint_actions = JointActions(self.worlds)
        self._digests = Digests(self.worlds, recording.header["digests"]["worlds"])
        self._check("words of given numbers", recording.header["given"], self.worlds.dims.get(GIVEN_WORDS, 0))
        self._check("actions", recording.header["actions"], [list(column) for column in self._joint_actions.columns])
        self._check("components", recording.components, self._digests.names)
        with announce_compilation(self.worlds, scenario.name):
            self.worlds.run(np.zeros(self.worlds.count, np.int8))  # compiles or loads the tick; no world runs

    @property
    def summary(self) -> Summary:  # noqa: D102  # described above
        each = self._known or 1
        self._first.episodes_per_world = each if self._first.episodes == each * self.worlds.count else 0
        return self._first if self._known or (self._known is None and self._first.episodes_per_world) else self._all

    def __repr__(self) -> str:
        return f"<Replay of {self.recording.path}: {self.recording.contents}>"

    def _repr_html_(self) -> str:
        return self.recording._repr_html_()

    def ticks(
        self, verify: bool = True, *, first: int = 0, last: int | None = None, worlds: Iterable[int] | None = None
    ) -> Iterator[int]:
        """Replay from the beginning, and yield the number of each tick once it is done; tick 0 resets all worlds.

        Args:
            verify: Whether to compare digests.
            first: Yield nothing before the tick of this number.
            last: Stop after the tick of this number; None: after the last one.
            worlds: Rows of the tables. Of the ticks after `first`, yield only those in which one of them took part.

        Returns:
            An iterator over the numbers of ticks. As there is only one set of worlds, it is of no more use once another
            one has been asked for its first tick.

        Raises:
            RecordingError: Ticks or rows do not exist; or, while iterating, the file is damaged, or another
                iterator has started.
            ReplayError: While iterating: the state after a tick differs from the recording.
        """
        if first or last is not None:
            last_tick(self.recording, first, last)
        return self._ticks(verify, first, last, None if worlds is None else rows_of(self.recording, worlds, 0))

    def _ticks(self, verify: bool, first: int, last: int | None, rows: list[int] | None) -> Iterator[int]:
        self._going = mine = object()
        self._all, self._first = Summary(), Summary()
        self.episodes[:] = 0
        for number, record in enumerate(self.recording.tick_records()):
            if self._going is not mine:
                raise RecordingError("another iterator of ticks() has begun anew; make a second Replay for both")
            self._run(record)
            if verify:
                self._compare(number, record.digest)
            self._count_episodes()
            if number == first or (number > first and (rows is None or self.worlds.mode[rows].any())):
                yield number
            if number == last:
                return

    def events(self) -> dict[str, Array]:
        """Return the events of the last tick like env.events(), but `episode` counts the recording's episodes."""
        return with_episodes(self.worlds.events(), self.episodes)

    def close(self) -> None:
        """Release the threads. The tables remain readable."""
        self.worlds.close()

    def _run(self, record: TickRecord) -> None:
        clock, rows = self.worlds[Clock], record.keys[:, 0].astype(np.intp)
        clock.seed[rows, 0], clock.world[rows, 0], clock.episode[rows, 0] = record.keys[:, 1:KEY_SIZE].T
        if Given in self.worlds and len(rows):
            words = record.keys[:, KEY_SIZE:]
            if wrong := wrongly_given(self.worlds.layout, words):
                raise RecordingError(f"{self.recording.path} is damaged: {wrong}")
            self.worlds[Given].words[rows] = words
        try:
            self.worlds.actions[:, record.mode == STEP] = self._joint_actions.decode(record.codes)
        except ValueError as error:
            raise RecordingError(f"{self.recording.path} is damaged: {error}") from None
        self.worlds.run(record.mode)
        self.episodes[record.mode == RESET] += 1
        if record.policy is not None:
            self.policy = np.full((self.worlds.count, self.recording.num_agents), np.nan, record.policy.dtype)
            self.policy[record.mode == STEP] = record.policy

    def _compare(self, number: int, expected: Array) -> None:
        different = np.flatnonzero(self._digests.compute(number) != expected)
        if not different.size:
            return
        names = [self._digests.names[k] for k in different]
        span = self._digests.span(number)
        which = f" (worlds {span.start} to {span.stop - 1})" if self._digests.turns > 1 else ""
        header = self.recording.header
        raise ReplayError(
            f"{self.recording.path}: tick {number} is the first that differs{which}, in {', '.join(names)}; "
            f"recorded by outlast {header['outlast']} on {header['machine']}"
        )

    def _count_episodes(self) -> None:
        """Count the episodes that ended in the last tick."""
        end = self.worlds[End]
        done = (end.terminated | end.truncated)[:, 0] & (self.worlds.mode == STEP)
        if done.any():
            found, present = statistics(self.worlds, done), counted(self.worlds)
            self._all.add(found, done, present)
            self._first.add(found, done & (self.episodes <= (self._known or 1)), present)

    def _check(self, what: str, there: object, here: object) -> None:
        if here != there:
            raise RecordingError(
                f"{self.recording.path}: {what} are {there} there and {here} here; it was recorded by outlast "
                f"{self.recording.header['outlast']}"
            )
