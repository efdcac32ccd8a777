"""Recording: the inputs of each tick are written to a file, with a digest of the state after the tick."""

import contextlib
import json
import math
import os
import platform
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from outlast.ecs import RESET, STEP, Clock, Worlds
from outlast.ecs.memory.numbers import GIVEN_WORDS, Given

from ..core.validation import Array
from ..errors import RecordingError
from ..scenarios.fingerprint import classes, fingerprint
from ..scenarios.scenario import Scenario
from ..storage.atomic_write import add, remove, temporary_path
from ..storage.interrupts import interrupts_held
from ..storage.outputs import check_file
from .container import DONE, HEAD, MAGIC, RECORDS, encode_chunk
from .digests import WORLDS_PER_DIGEST, Digests
from .policy_record import PolicyRecorder
from .tick_records import JointActions, TickFormat, TickRecord, encode_policies, encode_ticks

MAX_PENDING_BYTES = 2**19  # of waiting tick records; a killed process loses them
MAX_PENDING_SECONDS = 5.0  # maximum wait of tick records, which are then written with the next tick
FLAGS = os.O_WRONLY | getattr(os, "O_BINARY", 0)


class Recorder:
    """A recorder of every tick of an environment in the file `path`; made by outlast.record.

    A context manager; `close` writes the remaining ticks. It is an ecs.Observer of the environment's ticks.
    The file exists from the first tick on; without ticks none is made. Raises RecordingError if it exists or cannot
    be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        scenario: Scenario,
        worlds: Worlds,
        first_world: int = 0,
        policy: PolicyRecorder | None = None,
        wait: Callable[[], None] = lambda: None,
        episodes: int | None = None,
        played: dict[str, Any] | None = None,
    ) -> None:
        """wait: A function that returns when no tick runs in the background or is about to. The rest: see `record`."""
        self.path, self._worlds, self._policy, self._wait = Path(path), worlds, policy, wait
        self._joint_actions, self._digests = JointActions(worlds), Digests(worlds)
        form = TickFormat(
            *(worlds.count, worlds.dims["agents"], self._joint_actions.count),
            *(len(self._digests.names), self._digests.period),
            policy.dtype if policy else None,
            worlds.dims.get(GIVEN_WORDS, 0),
        )
        header = _header(scenario, form, self._joint_actions, self._digests) | {"first_world": first_world}
        more = {"episodes": episodes, "played": played, "policy": policy and policy.header}
        header |= {name: value for name, value in more.items() if value is not None}
        self._file = _Appender(self.path, header, form)
        # closes the file even if the process ends without close()
        self._finalizer = weakref.finalize(self, self._file.close)
        self._owner = os.getpid()
        self._continuous = False  # whether the worlds are in the state after the last recorded tick
        self._no_keys = np.zeros((0, form.key_size), np.uint64)
        self._keyed = np.zeros((worlds.count, form.key_size - 1), np.uint64)  # the recorded keys of each world

    @property
    def recording(self) -> bool:
        """Return whether the recording is still open."""
        return self._finalizer.alive

    @property
    def ticks(self) -> int:
        """Return the number of recorded ticks, including those that are not in the file yet."""
        return self._file.ticks

    def __repr__(self) -> str:
        return f"<Recorder to {self.path}: {self.ticks} ticks{'' if self.recording else ', closed'}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def check(self, mode: Array) -> None:
        """Raise RecordingError for a tick that cannot be recorded: after an interrupted one, any but a reset of all."""
        if os.getpid() != self._owner:
            raise RecordingError(f"{self.path} is recorded by another process; close() the recorder in this one")
        if not self._continuous and (mode != RESET).any():
            why = "a tick was interrupted" if self.ticks else "a recording begins with that"
            raise RecordingError(f"{self.path}: reset all worlds first, as {why}")

    def before(self, mode: Array) -> None:
        """Record the inputs of the tick."""
        steps, keys = mode == STEP, self._no_keys
        # given numbers may change between two ticks
        if steps.all() and Given not in self._worlds:
            codes = self._joint_actions.encode(self._worlds.actions)
        else:
            codes, keys = self._joint_actions.encode(self._worlds.actions[:, steps]), self._new_keys()
        thought = self._policy.look(steps) if self._policy else None  # about the observations before the tick
        self._continuous, self._begun = False, (codes, keys, thought)

    def after(self, mode: Array) -> None:
        """Record the tick. Raises RecordingError if the file cannot be written, which ends the recording."""
        codes, keys, thought = self._begun
        if (begun := mode == RESET).any():
            self._keyed[begun] = self._keys()[begun]  # a replay computes these from the previous keys
        digest = self._digests.compute(self.ticks)
        try:
            self._file.append(TickRecord(mode.copy(), codes, keys, digest, thought))
        except OSError as error:
            self._finalizer.detach()
            self._file.abandon()
            written = self._file.written
            kept = f", and the {written} ticks that are in the file can be replayed" if written else ""
            wrong = f"{self.path}: {error.strerror}; the recording ends here{kept}"
            raise RecordingError(f"{wrong}. The environment continues without it") from error
        self._continuous = True

    def close(self) -> None:
        """Write the remaining ticks, including a step that was sent, and mark the end. Raises RecordingError."""
        self._wait()
        try:
            self._finalizer()
        except OSError as error:
            raise RecordingError(f"{self.path}: {error.strerror}; its end is missing") from error

    def _keys(self) -> Array:
        """Return the keys of the random numbers of each world: rows of TickRecord.keys without the world's number."""
        clock = self._worlds[Clock]
        given = [self._worlds[Given].words] if Given in self._worlds else []
        return np.concatenate([clock.seed, clock.world, clock.episode, *given], 1)

    def _new_keys(self) -> Array:
        """Return the keys that do not follow from the recording so far, and mark them as recorded."""
        now = self._keys()
        rows = np.flatnonzero((now != self._keyed).any(1) | (not self._continuous))
        self._keyed[rows] = now[rows]
        return np.concatenate([rows[:, None].astype(np.uint64), now[rows]], 1)


class _Appender:
    """A file to which chunks of tick records are appended. Chunks that were written are never touched again.

    Its state is replaced at once when a chunk is in the file. So Ctrl-C, at any time, neither loses ticks
    nor writes them twice: an incomplete chunk is written again from its beginning.

    It is a temporary file until the first tick is in it, which is written at once: so no file without ticks is in the
    way of the next command, even if this process is refused something else, or is killed.
    """

    def __init__(self, path: Path, header: dict[str, Any], form: TickFormat) -> None:
        self._form, self._owner, self._since = form, os.getpid(), -math.inf
        target = Path(os.path.realpath(check_file(path, "recordings", RecordingError, new=True)))
        self._target: Path | None = target  # where the file goes; None: it exists
        self._place = temporary_path(target)
        # offset of the end, ticks in the file, tick records that wait
        self._state: tuple[int, int, list[TickRecord]] = (0, 0, [])
        self._pending_bytes, self._descriptor = 0, -1
        try:
            self._descriptor = os.open(self._place, FLAGS | os.O_CREAT | os.O_EXCL, 0o666)
            self._write(MAGIC + encode_chunk(HEAD, json.dumps(header).encode(), 0, 0), 0)
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from None
        finally:
            if not self._state[0]:
                self.abandon()

    @property
    def written(self) -> int:
        """Ticks in the file, if it exists."""
        return self._state[1] if self._target is None else 0

    @property
    def ticks(self) -> int:
        """Ticks in the file and waiting ones."""
        return self._state[1] + len(self._state[2])

    def append(self, record: TickRecord) -> None:
        """Append a tick. Raises OSError if the file cannot be written."""
        self._state[2].append(record)
        self._pending_bytes += record.nbytes
        if self._pending_bytes >= MAX_PENDING_BYTES or time.monotonic() - self._since > MAX_PENDING_SECONDS:
            self._flush()

    def close(self) -> None:
        """Write waiting ticks and DONE, and close the file. Raises OSError, after closing, if it cannot be written."""
        if os.getpid() != self._owner:
            os.close(self._descriptor)
            return
        try:
            self._flush()
            self._write(encode_chunk(DONE, b"", 0, self.ticks), 0)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file, and leave only complete chunks in it; without ticks, leave no file."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._state[0])
            os.close(self._descriptor)
        if self._target is not None:
            remove(self._place)

    def _flush(self) -> None:
        _, first, pending = self._state
        if pending:
            content, count = encode_ticks(pending, self._form), len(pending)
            self._write(encode_chunk(RECORDS, content, count, first, encode_policies(pending)), count)
            if self._target is not None:
                self._appear(self._target)
        self._pending_bytes, self._since = 0, time.monotonic()

    def _appear(self, target: Path) -> None:
        """Give the file its name. Raises OSError, as if another process has written one of that name."""
        with interrupts_held():
            os.close(self._descriptor)  # on Windows, files that are open cannot be renamed
            self._descriptor = -1
            add(self._place, target)
            self._descriptor, self._target = os.open(target, FLAGS), None

    def _write(self, content: bytes, ticks: int) -> None:
        offset, first, _ = self._state
        os.lseek(self._descriptor, offset, os.SEEK_SET)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
        self._state = (offset + len(content), first + ticks, [])


def _header(scenario: Scenario, form: TickFormat, joint_actions: JointActions, digests: Digests) -> dict[str, Any]:
    import outlast  # imported here, since it imports this package

    return {
        "outlast": outlast.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
        "scenario": fingerprint(scenario),
        "modules": classes(scenario),
        "given": form.given,
        "worlds": form.worlds,
        "agents": form.agents,
        "actions": [list(column) for column in joint_actions.columns],
        "digests": {"components": digests.names, "worlds": WORLDS_PER_DIGEST, "repeat": digests.period},
    }
