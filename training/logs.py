"""Logs of a run: a CSV file in the form of the paper's curves, and TensorBoard. Both go on where a run goes on."""

import csv
import io
import itertools
import os
import socket
import time
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from outlast.envs.errors import TrainingError
from outlast.envs.storage.atomic_write import atomic_write

from .curves import HEADER

FORMAT = "brain.Event:2"  # the first event of a file says so
_numbers = itertools.count()  # of event files that one process makes, perhaps in one second


class Curves(KVWriter):  # type: ignore[misc]  # mypy does not follow it
    """Appends rows tag,step,value to a file; step counts agent-steps."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("a", newline="")
        if self.file.tell() == 0:
            self.file.write(",".join(HEADER) + "\n")

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """One row for each tag, in order of tags, written at once."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerows((tag, step, repr(float(value))) for tag, value in sorted(key_values.items()))
        self.file.write(text.getvalue())
        self.file.flush()

    def close(self) -> None:
        """Close the file."""
        self.file.close()


class Board(KVWriter):  # type: ignore[misc]
    """Writes scalars for TensorBoard; those of an earlier part of the run after `step` are hidden.

    Events are in the file when `write` returns, or it raises OSError: TensorBoard's own writer has a thread for it.
    """

    def __init__(self, folder: Path, step: int) -> None:
        name = f"events.out.tfevents.{int(time.time()):010}.{socket.gethostname()}.{os.getpid()}.{next(_numbers):06}"
        self.file = (folder / name).open("wb")
        self.records = RecordWriter(self.file)
        self._add(file_version=FORMAT, step=step + 1)
        self._add(session_log=SessionLog(status=SessionLog.START), step=step + 1)
        self.file.flush()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """All values, as scalars."""
        for tag, value in key_values.items():
            self._add(summary=Summary(value=[Summary.Value(tag=tag, simple_value=float(value))]), step=step)
        self.file.flush()

    def close(self) -> None:
        """Close the event file."""
        self.file.close()

    def _add(self, **event: Any) -> None:
        self.records.write(Event(wall_time=time.time(), **event).SerializeToString())


def open_logs(folder: Path, steps: int) -> Logger:
    """The logs of a run that has done so many agent-steps: what they hold of later ones is taken out."""
    cut(folder / "log.csv", steps)
    return Logger(str(folder), [Curves(folder / "log.csv"), Board(folder, steps)])


def cut(path: Path, steps: int) -> None:
    """Take the rows after so many steps out of a CSV file, and a last row that was not written whole."""
    if not path.exists():
        return
    lines = path.read_text().splitlines(keepends=True)
    if lines and not ",".join(HEADER).startswith(lines[0].strip()):  # that, too, may not have been written whole
        raise TrainingError(f"{path} is not the log of a run: its first line is not {','.join(HEADER)}")
    kept = [line for line in lines[1:] if line.endswith("\n") and int(line.split(",")[1]) <= steps]
    with atomic_write(path) as place:
        place.write_text("".join([",".join(HEADER) + "\n", *kept]))
