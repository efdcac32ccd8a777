"""Recording: what decides each run of the tick goes into a file, and a digest of what came of it."""

import json
import os
import platform
import time
import weakref
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from outlast.ecs import RESET, STEP, Clock, Worlds

from ..errors import RecordingError
from ..scenarios.fingerprint import fingerprint
from ..scenarios.scenario import Scenario
from ..scenarios.serialize import classes
from .container import DONE, HEAD, MAGIC, RUNS, frame
from .digests import AT_ONCE, Digests
from .joint_action import Joint
from .tick_records import KEY, Run, Shape, pack

Array = np.ndarray[Any, Any]

LARGEST = 2**19  # bytes that wait to be written, at most: what a killed process loses
NO_KEYS = np.zeros((0, KEY), np.uint64)
LONGEST = 5.0  # seconds that they wait, as long as runs go on


class Recorder:
    """Runs worlds, and records every run in the file `path`; see SurvivalVectorEnv.record.

    Works as a context manager; `close` writes what is left. After close it goes on
    running the worlds, and records nothing. Raises RecordingError if the file exists, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str], scenario: Scenario, worlds: Worlds, first_world: int = 0) -> None:
        self.path, self._worlds = Path(path), worlds
        self._joint, self._digests = Joint(worlds), Digests(worlds)
        shape = Shape(
            worlds.count, worlds.dims["agents"], self._joint.dtype, len(self._digests.names), self._digests.repeat
        )
        head = _header(scenario, shape, self._joint, self._digests) | {"first_world": first_world}
        self._file = _Appender(self.path, head, shape)
        self._end = weakref.finalize(self, self._file.close)  # also when the process ends without close()
        self._owner = os.getpid()
        self._whole = False  # whether the worlds are where the last recorded run left them
        self._clock = np.zeros((worlds.count, KEY - 1), np.uint64)  # and their clocks, as far as they are recorded

    @property
    def recording(self) -> bool:
        """Whether it has not been closed."""
        return self._end.alive

    @property
    def runs(self) -> int:
        """Runs recorded, among them those that are not in the file yet."""
        return self._file.runs

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def run(self, mode: Array) -> None:
        """Take every world through the tick, as Worlds.run, and record it.

        A run that is interrupted is not recorded; only a reset of all worlds goes on from there. Raises RecordingError
        if that is missing, or if the file cannot be written, with which the recording ends.
        """
        if not self.recording:
            self._worlds.run(mode)
            return
        self.check(mode)
        steps, keys = mode == STEP, NO_KEYS
        if all_step := bool(steps.all()):
            codes = self._joint.encode(self._worlds.actions)
        else:
            codes, keys = self._joint.encode(self._worlds.actions[:, steps]), self._keys()
        self._whole = False
        self._worlds.run(mode)
        if not all_step:
            self._clock[mode == RESET, -1] += np.uint64(1)  # episode
        digest = self._digests.take(self.runs)
        try:
            self._file.append(Run(mode.copy(), codes, keys, digest))
        except OSError as error:
            self._end.detach()
            self._file.abandon()
            raise RecordingError(
                f"{self.path}: {error.strerror}; the recording ends here, and the {self._file.written} runs that are "
                "in the file can be replayed. The environment goes on without it"
            ) from error
        self._whole = True

    def close(self) -> None:
        """Write what is left, and that this is all. Raises RecordingError if that is impossible."""
        try:
            self._end()
        except OSError as error:
            raise RecordingError(f"{self.path}: {error.strerror}; its end is missing") from error

    def check(self, mode: Array) -> None:
        """Raise RecordingError if a run of these modes cannot be recorded."""
        if os.getpid() != self._owner:
            raise RecordingError(f"{self.path} is recorded by another process; close() the recorder in this one")
        if not self._whole and (mode != RESET).any():
            why = "a run was interrupted" if self.runs else "a recording begins with that"
            raise RecordingError(f"{self.path}: reset all worlds before anything else, as {why}")

    def _keys(self) -> Array:
        """What keys random numbers, where it is not what the recording so far says; and take note of it."""
        clock = self._worlds[Clock]
        now = np.concatenate([clock.seed, clock.world, clock.episode], 1)
        rows = np.flatnonzero((now != self._clock).any(1) | (not self._whole))
        self._clock[rows] = now[rows]
        return np.concatenate([rows[:, None].astype(np.uint64), now[rows]], 1)


class _Appender:
    """Appends frames of runs to a file. What was written before is never touched again.

    Its state is replaced as a whole once a frame is in the file, so that Ctrl-C at any moment neither loses runs nor
    writes them twice: a frame that was begun is begun again.
    """

    def __init__(self, path: Path, head: dict[str, Any], shape: Shape) -> None:
        self.shape, self._owner, self._since = shape, os.getpid(), time.monotonic()
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        try:
            self._descriptor = os.open(path, flags, 0o666)
        except FileExistsError:
            raise RecordingError(
                f"{path} exists; a recording overwrites nothing: give another name, or delete it"
            ) from None
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror}; no recording can be written there") from None
        self._state: tuple[int, int, list[Run]] = (0, 0, [])  # offset of the end, runs written, runs that wait
        self._bytes = 0  # that wait
        try:
            self._write(MAGIC + frame(HEAD, json.dumps(head).encode(), 0, 0), 0)
        except OSError as error:
            os.close(self._descriptor)
            path.unlink()
            raise RecordingError(f"{path}: {error.strerror}; no recording can be written there") from None

    @property
    def written(self) -> int:
        """Runs in the file."""
        return self._state[1]

    @property
    def runs(self) -> int:
        """Runs in the file, and those that wait."""
        return self._state[1] + len(self._state[2])

    def append(self, run: Run) -> None:
        """Append a run. Raises OSError if the file cannot be written."""
        self._state[2].append(run)
        self._bytes += run.nbytes
        if self._bytes >= LARGEST or time.monotonic() - self._since > LONGEST:
            self._flush()

    def close(self) -> None:
        """Write what waits and the end. Raises OSError, after having closed the file."""
        try:
            if os.getpid() == self._owner:
                self._flush()
                self._write(frame(DONE, b"", 0, self.runs), 0)
        except OSError:
            self._cut()
            raise
        finally:
            os.close(self._descriptor)

    def abandon(self) -> None:
        """Leave what is whole in the file."""
        self._cut()
        os.close(self._descriptor)

    def _flush(self) -> None:
        _, first, waiting = self._state
        if waiting:
            self._write(frame(RUNS, pack(waiting, self.shape), len(waiting), first), len(waiting))
        self._bytes, self._since = 0, time.monotonic()

    def _write(self, content: bytes, runs: int) -> None:
        offset, first, _ = self._state
        os.lseek(self._descriptor, offset, os.SEEK_SET)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
        self._state = (offset + len(content), first + runs, [])

    def _cut(self) -> None:
        os.ftruncate(self._descriptor, self._state[0])


def _header(scenario: Scenario, shape: Shape, joint: Joint, digests: Digests) -> dict[str, Any]:
    import outlast  # here, as it imports this package

    return {
        "outlast": outlast.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
        "scenario": fingerprint(scenario),
        "modules": classes(scenario),
        "worlds": shape.worlds,
        "agents": shape.agents,
        "actions": [list(column) for column in joint.columns],
        "digests": {"components": digests.names, "worlds": AT_ONCE, "repeat": digests.repeat},
    }
