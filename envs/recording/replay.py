"""Replaying: the recorded runs of the tick once more, each compared with the digest of what it was."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from outlast.components import End
from outlast.ecs import STEP, Clock, EngineError, Worlds

from ..core.lifecycle import check_playable
from ..core.notice import announce_compilation
from ..core.spaces import statistics
from ..errors import RecordingError, ReplayError, ScenarioError
from ..rollout.summary import Summary
from .digests import Digests
from .joint_action import Joint
from .reader import Recording
from .tick_records import Run

Array = np.ndarray[Any, Any]


class Replay:
    """The worlds of a recording, and the runs that it holds of them.

    worlds: an ecs.Worlds; read its tables and its `mode` between runs. summary: of the episodes that ended so far.
    Raises RecordingError if this outlast has other actions or components than the one that recorded.
    """

    def __init__(self, recording: Recording, threads: int = 1) -> None:
        self.recording, self.summary = recording, Summary()
        try:
            self.worlds = Worlds(recording.scenario.modules, recording.num_worlds, threads)
            check_playable(self.worlds, recording.scenario.name)
        except (EngineError, ScenarioError, MemoryError) as error:
            raise RecordingError(f"{recording.path}: its worlds cannot be made: {error}") from error
        self._joint, self._digests = Joint(self.worlds), Digests(self.worlds, recording.header["digests"]["worlds"])
        self._check()
        with announce_compilation(self.worlds, recording.scenario.name):
            self.worlds.run(np.zeros(self.worlds.count, np.int8))  # nobody moves, but the tick gets compiled or loaded

    def ticks(self, verify: bool = True) -> Iterator[int]:
        """Run the recorded runs from the first on, and yield the number of each once it is run: 0 resets all worlds.

        verify: compare digests. Raises ReplayError at the first run after which the state is not what it was.
        """
        self.summary = Summary()
        for number, run in enumerate(self.recording.runs()):
            self._repeat(run)
            if verify:
                self._compare(number, run.digest)
            self._count()
            yield number

    def close(self) -> None:
        """Let the threads go. The tables stay readable."""
        self.worlds.close()

    def _repeat(self, run: Run) -> None:
        clock, rows = self.worlds[Clock], run.keys[:, 0].astype(np.intp)
        clock.seed[rows, 0], clock.world[rows, 0], clock.episode[rows, 0] = run.keys[:, 1:].T
        try:
            self.worlds.actions[:, run.mode == STEP] = self._joint.decode(run.codes)
        except ValueError as error:
            raise RecordingError(f"{self.recording.path} is damaged: {error}") from None
        self.worlds.run(run.mode)

    def _compare(self, number: int, expected: Array) -> None:
        different = np.flatnonzero(self._digests.take(number) != expected)
        if not different.size:
            return
        names = [self._digests.names[k] for k in different]
        span = self._digests.span(number)
        which = f" (worlds {span.start} to {span.stop - 1})" if self._digests.period > 1 else ""
        header = self.recording.header
        raise ReplayError(
            f"{self.recording.path}: run {number} is the first that differs{which}, in {', '.join(names)}; "
            f"recorded by outlast {header['outlast']} on {header['machine']}"
        )

    def _count(self) -> None:
        """Count the episodes that ended in the last run."""
        end = self.worlds[End]
        over = (end.terminated | end.truncated)[:, 0] & (self.worlds.mode == STEP)
        if over.any():
            self.summary.add(statistics(self.worlds, over), over)

    def _check(self) -> None:
        recording = self.recording
        own = {
            "agents": self.worlds.dims["agents"],
            "actions": [list(column) for column in self._joint.columns],
            "components": self._digests.names,
        }
        its = {
            "agents": recording.num_agents,
            "actions": recording.header["actions"],
            "components": recording.components,
        }
        for key, mine in own.items():
            if mine != its[key]:
                raise RecordingError(
                    f"{recording.path}: {key} are {its[key]} there and {mine} here; it was recorded by outlast "
                    f"{recording.header['outlast']}"
                )
