"""The writers of a run's logs: log.csv and TensorBoard's events. Both are continued when a run is resumed."""

import csv
import io
import itertools
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from ..base import log_file

FORMAT = "brain.Event:2"  # the first event of a file says so
_numbers = itertools.count()  # one for each event file of this process, which may make several in one second


class CsvLog:
    """A log of rows tag,step,value in a file; step counts agent-steps."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("a", newline="", encoding="utf-8")
        if self.file.tell() == 0:
            self.file.write(",".join(log_file.HEADER) + "\n")
            self.file.flush()

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Write one row for each tag, in order of tags, all at once."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerows((tag, step, repr(float(value))) for tag, value in sorted(values.items()))
        self.file.write(text.getvalue())
        self.file.flush()

    def close(self) -> None:
        """Close the file."""
        self.file.close()


class TensorBoardLog:
    """A writer of scalars for TensorBoard, which hides those of an earlier part of the run after `step`.

    When `write` returns, the events are in the file; if they cannot be written, it raises OSError. TensorBoard's own
    writer leaves that to a thread.
    """

    def __init__(self, folder: Path, step: int) -> None:
        name = f"events.out.tfevents.{int(time.time()):010}.{socket.gethostname()}.{os.getpid()}.{next(_numbers):06}"
        self.file = (folder / name).open("wb")
        self.records = RecordWriter(self.file)
        self._add(file_version=FORMAT, step=step + 1)
        self._add(session_log=SessionLog(status=SessionLog.START), step=step + 1)
        self.file.flush()

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Write values by tag at an agent-step, as scalars."""
        for tag, value in values.items():
            self._add(summary=Summary(value=[Summary.Value(tag=tag, simple_value=float(value))]), step=step)
        self.file.flush()

    def close(self) -> None:
        """Close the event file."""
        self.file.close()

    def _add(self, **event: Any) -> None:
        self.records.write(Event(wall_time=time.time(), **event).SerializeToString())


class RunLog:
    """The logs of a run that has done `steps` agent-steps; what they hold of later steps is removed."""

    def __init__(self, folder: Path, steps: int) -> None:
        path = folder / log_file.NAME
        log_file.truncate_log(path, steps)
        self.logs: list[CsvLog | TensorBoardLog] = [CsvLog(path), TensorBoardLog(folder, steps)]

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Log values by tag at an agent-step."""
        for log in self.logs:
            log.write(values, step)

    def close(self) -> None:
        """Close the files."""
        for log in self.logs:
            log.close()
