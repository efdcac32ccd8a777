"""Replaying: a recording is read, its ticks are run again, and each is compared with its recorded digest."""

import math
import os
from collections.abc import Generator, Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from outlast.components import End
from outlast.ecs import RESET, STEP, Clock, EngineError
from outlast.ecs.kernels.integers import is_whole
from outlast.ecs.memory.given import wrongly_given
from outlast.ecs.memory.numbers import GIVEN_WORDS, Given

from ..core.lifecycle import announce_compilation, check_playable
from ..core.spaces import counted, statistics
from ..core.validation import Array, check_count
from ..errors import RecordingError, ReplayError, ScenarioError
from ..rollout.summary import Summary
from ..rollout.table_file import with_episodes
from ..scenarios.fingerprint import classes, difference, fingerprint, planned, rebuilt
from ..scenarios.parse import resolve
from ..scenarios.scenario import Scenario
from ..scenarios.scenario_json import foreign
from . import file_format
from .file_format import DONE, HEAD, KEY_SIZE, RECORDS, Chunk, JointActions, TickFormat, TickRecord
from .recorder import Digests

# bytes of worlds that any file may request, and more for each of its bytes
MAX_WORLDS_BYTES, MORE_FOR_EACH_BYTE = 2**30, 10_000


class Recording:
    """A recording of an environment in a file, made by `open`; len(recording) is the number of its ticks.

    Attributes:
        header: Description in the file: `outlast`, `machine`, `scenario` ...
        scenario: The scenario that was played.
        num_worlds, num_agents, first_world: As in SurvivalVectorEnv; `num_agents` is per world.
        entities: If a policy was recorded, what it attended to: (key of the observation, rows) for each kind.
        cut: Empty, or a sentence about the missing end of the file, because its writer was killed or still runs.
    """

    def __init__(self, path: str, header: dict[str, Any], scenario: Scenario, chunks: list[Chunk], size: int) -> None:
        self.path, self.header, self.scenario = path, header, scenario
        self._place = Path(path).absolute()  # stays right if the working directory changes
        self.components: list[str] = header["digests"]["components"]
        self.num_worlds, self.num_agents, self.first_world = header["worlds"], header["agents"], header["first_world"]
        self._chunks = [chunk for chunk in chunks if chunk.tag == RECORDS]
        self._length = sum(chunk.ticks for chunk in self._chunks)
        self._format = TickFormat(header)
        self.entities = [(str(key), int(rows)) for key, rows in header.get("policy", {"entities": []})["entities"]]
        self.cut = ""
        if chunks[-1].tag != DONE:
            lost = f"{size - chunks[-1].end} bytes after them are left out"
            self.cut = f"{path} was cut off: {self._length} ticks are complete, {lost}"

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], scenario: Scenario | str | None = None, *, trust: bool = False
    ) -> "Recording":
        """Read a file and check all of it. An unfinished end, left by a killed writer, is ignored (see `cut`).

        Args:
            path: A file that `outlast.record` or `outlast rollout --record` wrote.
            scenario: Needed if some of its mechanics are neither outlast's own nor imported, as names in a file are
                never imported: the recorded scenario, or the name of a scenario, such as "mygame.py:arena", which is
                imported for its mechanics, with any numbers.
            trust: Whether its worlds may take as much memory as they need. If not, 1 GiB is the limit, unless the file
                is long.

        Returns:
            The recording. The file is read again, chunk by chunk, when ticks are requested.

        Raises:
            RecordingError: The file is not a recording, is damaged, or is of another scenario.
            OSError: The file cannot be read.
        """
        name, size = os.fspath(path), Path(path).stat().st_size
        with open(path, "rb") as file:
            chunks = list(file_format.read_chunks(file, name, size))
            if not chunks or chunks[0].tag != HEAD:
                raise RecordingError(f"{name} is not a recording: it ends before the description of what was recorded")
            header = file_format.read_header(file, name, chunks[0])
            recording = cls(name, header, _scenario(name, header, scenario), chunks, size)
            recording._check_size(math.inf if trust else MAX_WORLDS_BYTES + MORE_FOR_EACH_BYTE * size)
            for first in recording._chunks[:1]:
                begin = recording._decoded(file, first)[0]
                keyed = np.array_equal(begin.keys[:, 0], np.arange(recording.num_worlds))
                if (begin.mode != RESET).any() or not keyed:
                    raise RecordingError(f"{name} does not begin with a reset of all worlds")
        return recording

    @property
    def contents(self) -> str:
        """A description of the recording: "teams_3, 64 worlds, 601 ticks"."""
        return f"{self.scenario.name}, {self.num_worlds} worlds, {len(self):,} ticks"

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {self.contents}{', cut off' if self.cut else ''}>"

    def _repr_html_(self) -> str:
        pages = import_module("outlast.envs.web.pages")  # imported here, as pages import this package
        return str(pages.frame(self))

    def __len__(self) -> int:
        return self._length

    def tick_records(self) -> Generator[TickRecord, None, None]:
        """Iterate over the records of ticks, reading a chunk at a time. The first tick resets all worlds.

        Yields:
            Modes, joint actions, keys of random numbers and a digest. Resets are ticks, too.

        Raises:
            RecordingError: The file is damaged.
        """
        with self._place.open("rb") as file:
            for chunk in self._chunks:
                yield from self._decoded(file, chunk)

    def _check_size(self, most: float) -> None:
        """Refuse worlds of more than `most` bytes: a small file could request an absurd amount."""
        try:
            agents, each = planned(self.scenario)
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{self.path}: its worlds cannot be made: {error}") from None
        if agents != self.num_agents:
            raise RecordingError(f"{self.path}: agents are {self.num_agents} there and {agents} here")
        if (asked := each * self.num_worlds) > most:
            raise RecordingError(
                f"{self.path}: its worlds would take {asked} bytes: {most} are given to a file so small; if you know "
                "where it is from, open it with Recording.open(path, trust=True) or replay --trust"
            )

    def _decoded(self, file: BinaryIO, chunk: Chunk) -> list[TickRecord]:
        most = file_format.MAX_PENDING_BYTES + self._format.max_bytes
        content, behind = file_format.read_content(file, self.path, chunk, most)
        try:
            return list(file_format.decode_ticks(content, chunk.ticks, self._format, behind))
        except ValueError:
            raise file_format.damaged(self.path, chunk.offset) from None


def _scenario(path: str, header: dict[str, Any], given: Scenario | str | None) -> Scenario:
    """Return the scenario of the file, or the given one if it is the same. Raises RecordingError otherwise."""
    if not isinstance(given, Scenario):
        try:
            if given is not None and not foreign(header["modules"]):
                raise ScenarioError(f"all of its mechanics are outlast's own: leave out the scenario {given}")
            if given is not None:
                resolve(given)  # which imports its mechanics
            given = rebuilt(header["scenario"], header["modules"])
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{path}: {error}") from None
    if other := difference(header["scenario"], fingerprint(given)):
        raise RecordingError(f"{path} is of another scenario {other}")
    if sorted(header["modules"]) != classes(given):
        raise RecordingError(f"{path} was made with {header['modules']}: the scenario given has {classes(given)}")
    return given


def last_tick(recording: Recording, first: int, last: int | None) -> int:
    """Return the number of the last tick of a selection, by default that of the recording.

    Raises RecordingError if the ticks do not exist.
    """
    given: list[Any] = [first, 0 if last is None else last]
    if strange := [tick for tick in given if not is_whole(tick)]:
        raise RecordingError(f"tick {strange[0]!r}: integers are needed, counted from 0")
    if not len(recording):
        raise RecordingError(f"{recording.path}: it has no ticks")
    most = len(recording) - 1
    end = most if last is None else last
    if not 0 <= first <= end <= most:
        raise RecordingError(
            f"ticks {first} to {end}: 0 <= from <= to <= {most} is needed, the last tick of {recording.path}"
        )
    return end


def rows_of(recording: Recording, worlds: Any, first: int | None = None) -> list[int]:
    """Return the rows of these worlds in the tables. Raises RecordingError if the worlds do not exist.

    first: Number of the first world; None: that in tables of events and samples, `first_world`.
    """
    if not isinstance(worlds, Iterable):
        raise RecordingError(f"worlds = {worlds!r}: their numbers are needed, as in [0, 3]")
    asked, first = list(worlds), recording.first_world if first is None else first
    last = first + recording.num_worlds - 1
    if odd := [w for w in asked if not is_whole(w)]:
        raise RecordingError(f"world {odd[0]!r}: integers are needed")
    if unknown := [w for w in asked if not first <= w <= last]:
        raise RecordingError(f"{recording.path}: world {unknown[0]} does not exist; they are {first} to {last}")
    return [w - first for w in asked]


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
        policy: The record of the policy before that tick, file_format.policy_dtype (worlds, agents), NaN in
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
        for what, there, here in (
            ("words of given numbers", recording.header["given"], self.worlds.dims.get(GIVEN_WORDS, 0)),
            ("actions", recording.header["actions"], [list(column) for column in self._joint_actions.columns]),
            ("components", recording.components, self._digests.names),
        ):
            if here != there:
                version = f"it was recorded by outlast {recording.header['outlast']}"
                raise RecordingError(f"{recording.path}: {what} are {there} there and {here} here; {version}")
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
        names, span = [self._digests.names[k] for k in different], self._digests.span(number)
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
