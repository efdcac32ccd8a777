"""log.csv of a run: a row (tag, agent-steps, value) for each logged number. Does not need PyTorch."""

import csv
from pathlib import Path

from outlast.envs.storage.atomic_write import atomic_write

from .errors import TrainingError
from .files import read_text

NAME = "log.csv"
HEADER = ("tag", "step", "value")
LAST = 2**53  # the highest step: a float64 holds every integer up to here
Points = dict[str, list[tuple[int, float]]]


def read_log(path: Path) -> Points:
    """Read the points (agent-steps, value) of each tag of a log. Raises TrainingError if it is not a log.

    An incomplete last row is left out: a run may be writing it.
    """
    lines = read_text(path).splitlines(keepends=True)
    if not lines or lines[0].strip() != ",".join(HEADER):
        raise TrainingError(f"{path} is not the log of a run: its first line is not {','.join(HEADER)}")
    points: Points = {}
    for number, line in enumerate(lines[1:], 2):
        if line.endswith("\n"):
            tag, step, value = _row(path, number, line)
            before = points.setdefault(tag, [])
            if before and step <= before[-1][0]:
                wrong = f"{tag} at step {step} comes after that at step {before[-1][0]}"
                raise TrainingError(f"{path}, line {number}: {wrong}: the file holds several runs")
            before.append((step, value))
    return points


def _row(path: Path, number: int, line: str) -> tuple[str, int, float]:
    """Return the tag, the step and the value of a line. Raises TrainingError."""
    try:
        tag, step, value = next(csv.reader([line]))
        if 0 <= int(step) <= LAST:
            return tag, int(step), float(value)
    except (ValueError, csv.Error):
        pass
    raise TrainingError(f"{path}, line {number}: {line.strip()!r} is not a tag, a step, a value")


def last_step(path: Path) -> int:
    """Return the agent-steps of the last complete row of a log that is being written; 0 without one."""
    try:
        lines = path.read_text(encoding="utf-8").rpartition("\n")[0].splitlines()
        return int(next(csv.reader(lines[:0:-1]))[1])
    except (OSError, ValueError, IndexError, StopIteration, csv.Error):
        return 0


def truncate_log(path: Path, steps: int) -> None:
    """Remove all rows after `steps` agent-steps from a log, and an incomplete last row.

    Raises TrainingError if the file is not a log.
    """
    if not path.exists():
        return
    lines = read_text(path).splitlines(keepends=True)
    if lines and not ",".join(HEADER).startswith(lines[0].strip()):  # the heading may be incomplete, too
        raise TrainingError(f"{path} is not the log of a run: its first line is not {','.join(HEADER)}")
    complete = [(number, line) for number, line in enumerate(lines[1:], 2) if line.endswith("\n")]
    kept = [line for number, line in complete if _row(path, number, line)[1] <= steps]
    with atomic_write(path) as place:
        place.write_text("".join([",".join(HEADER) + "\n", *kept]), encoding="utf-8")
