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

FORMAT = "brain.Event:2"  # content of the first event of a file
_numbers = itertools.count()  # one for each event file of this process, which may create several in one second


class RunLog:
    """The logs of a run that has done `steps` agent-steps; entries of later steps are removed, or hidden.

    When `write` returns, all entries are in the files, or OSError is raised. TensorBoard's own writer leaves writing to
    a thread.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        log_file.truncate_log(folder / log_file.NAME, steps)
        self.rows = (folder / log_file.NAME).open("a", newline="", encoding="utf-8")
        if self.rows.tell() == 0:
            self.rows.write(",".join(log_file.HEADER) + "\n")
            self.rows.flush()
        name = f"events.out.tfevents.{int(time.time()):010}.{socket.gethostname()}.{os.getpid()}.{next(_numbers):06}"
        self.events = (folder / name).open("wb")
        self.records = RecordWriter(self.events)
        self._add(file_version=FORMAT, step=steps + 1)
        self._add(session_log=SessionLog(status=SessionLog.START), step=steps + 1)
        self.events.flush()

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Log values by tag at an agent-step: rows tag,step,value in order of tags, all at once; and scalars."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerows((tag, step, repr(float(value))) for tag, value in sorted(values.items()))
        self.rows.write(text.getvalue())
        for tag, value in values.items():
            self._add(summary=Summary(value=[Summary.Value(tag=tag, simple_value=float(value))]), step=step)
        for file in (self.rows, self.events):
            file.flush()

    def close(self) -> None:
        """Close the files."""
        self.rows.close()
        self.events.close()

    def _add(self, **event: Any) -> None:
        self.records.write(Event(wall_time=time.time(), **event).SerializeToString())
