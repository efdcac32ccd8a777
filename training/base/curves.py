"""Learning curves: read from a run's log.csv or from the file of several runs; averages and end values. By numpy."""

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.storage import inputs
from outlast.envs.storage.outputs import atomic_write

from .errors import EmptyRunError, TrainingError
from .files import packed, read_bytes, read_text, unpacked
from .quantities import csv_text

LOG = "log.csv"
HEADING = ("tag", "step", "value")
LAST = 2**53  # the highest step: a float64 holds every integer up to here
Points = dict[str, list[tuple[int, float]]]
FILE = "curves.csv.xz"  # the curves of several runs, in a folder of results that are kept
BEYOND = 1e30  # values are below this, so that they can be squared and added up
END = 0.1  # share of the points that counts as the end of a run
SMOOTH = 20  # a moving average spans 1 / SMOOTH of the points
STUDENT = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262)  # 97.5 % of t, 1 to 9 degrees of freedom
Array = np.ndarray[Any, Any]
NEEDED = ("rollout/steps", "rollout/reward0")  # every run in which an episode has ended has them


def read_log(path: Path) -> Points:
    """Read the points (agent-steps, value) of each tag of a log that may be growing. Raises TrainingError."""
    lines = read_text(path).splitlines(keepends=True)
    _check_heading(path, bool(lines) and lines[0].strip() == ",".join(HEADING))
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


def _check_heading(path: Path, sound: bool) -> None:
    if not sound:
        raise TrainingError(f"{path} is not the log of a run: its first line is not {','.join(HEADING)}")


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
    """Remove all rows after `steps` agent-steps from a log, and an incomplete last row. Raises TrainingError."""
    if not path.exists():
        return
    lines = read_text(path).splitlines(keepends=True)
    _check_heading(path, not lines or ",".join(HEADING).startswith(lines[0].strip()))  # it may be incomplete, too
    complete = [(number, line) for number, line in enumerate(lines[1:], 2) if line.endswith("\n")]
    kept = [line for number, line in complete if _row(path, number, line)[1] <= steps]
    with atomic_write(path) as place:
        place.write_text("".join([",".join(HEADING) + "\n", *kept]), encoding="utf-8")


@dataclass(frozen=True)
class Quantity:
    """A logged quantity. tag: Tag in TensorBoard. sided: Whether each agent or team has a tag: tag0, tag1 and so on."""

    name: str
    tag: str
    sided: bool = False

    def has(self, tag: str) -> bool:
        """Return whether the tag belongs to this quantity."""
        number = tag.removeprefix(self.tag)
        fits = re.fullmatch("0|[1-9][0-9]{0,3}", number) is not None if self.sided else not number
        return fits and tag.startswith(self.tag)

    def side(self, tag: str) -> int:
        """Return the number of the agent or team in a tag; -1 if the quantity is not sided."""
        return int(tag[len(self.tag) :]) if self.sided else -1


RETURN, LENGTH = Quantity("return", "rollout/reward", sided=True), Quantity("episode length", "rollout/steps")
HEALS, KILLS = Quantity("heals used", "rollout/heals_used"), Quantity("kills", "rollout/kills", sided=True)
BOXES = Quantity("boxes placed", "rollout/boxes_placed")
QUANTITIES = (RETURN, LENGTH, HEALS, KILLS, BOXES)  # of the paper; every logged value is finite


def is_known(tag: str) -> bool:
    """Return whether the tag is one of the paper's quantities."""
    return any(quantity.has(tag) for quantity in QUANTITIES)


@dataclass(frozen=True)
class Curves:
    """Curves over the same points."""

    steps: Array  # agent-steps, int64 (points,), ascending
    values: dict[str, Array]  # by tag, float32 (points,), NaN where a rollout has none

    def tags(self, quantity: Quantity) -> list[str]:
        """Return the existing tags of a quantity, in order of sides."""
        return sorted((tag for tag in self.values if quantity.has(tag)), key=quantity.side)


Described = tuple[dict[str, Any], Curves]  # the description of a run, and its curves


def thinned(curves: Curves, most: int) -> Curves:
    """Reduce curves to at most `most` points, each the mean of neighbours, at the last of their steps."""
    starts = np.arange(0, len(curves.steps), -(-len(curves.steps) // most))
    ends = np.append(starts[1:], len(curves.steps)) - 1
    values = dict[str, Array]()
    for tag, own in curves.values.items():
        there = np.isfinite(own)  # a part without a number is NaN
        counts = np.add.reduceat(there, starts, dtype=np.float64)
        sums = np.add.reduceat(np.where(there, own, 0), starts, dtype=np.float64)
        values[tag] = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).astype(np.float32)
    return Curves(curves.steps[ends], values)


def rounded(curves: Curves, digits: int) -> Curves:
    """Round the values of curves to a number of significant digits."""
    values = {tag: np.array([f"{value:.{digits}g}" for value in own], np.float32) for tag, own in curves.values.items()}
    return Curves(curves.steps, values)


def curves_of_log(path: Path, known: Callable[[str], bool]) -> Curves:
    """Return the curves in the log of a run. Raises EmptyRunError before the first episode has ended, or TrainingError.

    known: Returns whether a tag must have finite values only; other tags may have NaN.
    """
    begun = path.exists() and path.stat().st_size > 0  # otherwise the run has not written its first row yet
    points = read_log(path) if begun else {}
    for tag in NEEDED:
        if tag not in points:
            raise EmptyRunError(f"{path} has no {tag}: no episode has ended in it yet, or outlast did not write it")
    for tag, rows in points.items():
        if bad := [step for step, value in rows if known(tag) and not abs(value) < BEYOND]:
            raise TrainingError(f"{path} is broken: {tag} at step {bad[0]} is not a finite number")
    steps = np.array(sorted({step for rows in points.values() for step, _ in rows}), np.int64)
    return Curves(steps, {tag: _spread(rows, steps) for tag, rows in sorted(points.items())})


def _spread(rows: list[tuple[int, float]], steps: Array) -> Array:
    """Return the values at all steps, NaN where a step has none."""
    values = np.full(len(steps), np.nan, np.float32)
    own = [value if abs(value) < BEYOND else np.nan for _, value in rows]
    values[np.searchsorted(steps, [step for step, _ in rows])] = own
    return values


def format_curves(runs: Mapping[str, Described]) -> bytes:
    """Return runs by their names as a compressed CSV file: a comment with descriptions, and a row for each point.

    Numbers have the fewest digits that give the same float32. Equal runs give equal bytes.
    """
    tags, rows = sorted({tag for _, curves in runs.values() for tag in curves.values}), list[list[Any]]()
    for name, (_, curves) in runs.items():
        none = np.full(len(curves.steps), np.nan)
        values = (curves.values.get(tag, none) for tag in tags)
        columns = [["" if np.isnan(x) else np.format_float_positional(x, trim="-") for x in own] for own in values]
        rows += ([name, *row] for row in zip(curves.steps.tolist(), *columns, strict=True))
    about = json.dumps({name: about for name, (about, _) in runs.items()}, separators=(",", ":"))
    return packed(f"# {about}\n" + csv_text(["run", "step", *tags], rows))


def read_curves(path: Path) -> dict[str, Described]:
    """Read a file written by `format_curves`. Raises TrainingError for any other file."""
    content = read_bytes(path)
    try:
        return dict(_parse(content))
    except (*inputs.BROKEN_JSON, csv.Error) as error:
        raise TrainingError(f"{path} does not hold the curves of runs: {error}") from None


@lru_cache(maxsize=8)  # the runs of a file are requested one by one
def _parse(content: bytes) -> dict[str, Described]:
    first, _, rest = unpacked(content).partition("\n")
    if not first.startswith("# "):
        raise ValueError("its first line does not describe the curves")
    about = json.loads(first[2:])
    heads, *rows = csv.reader(io.StringIO(rest), strict=True)
    if heads[:2] != ["run", "step"] or len(set(heads)) < len(heads):
        raise ValueError("its columns are not run, step and tags")
    points: dict[str, list[list[str]]] = {name: [] for name in about}
    for number, row in enumerate(rows, 3):
        if len(row) != len(heads):
            raise ValueError(f"line {number} has {len(row)} cells, but the heading {len(heads)}: was it cut off?")
        if row[0] not in points:
            raise ValueError(f"line {number} belongs to {row[0]!r:.80}, which its first line does not describe")
        points[row[0]].append(row[1:])
    if odd := [name for name in points if not name.isprintable() or Path(name).name != name]:
        raise ValueError(f"{odd[0]!r:.80} is not a valid name of a run")
    return {name: (about[name], _columns(heads[2:], own)) for name, own in points.items()}


def _columns(tags: Sequence[str], rows: Sequence[Sequence[str]]) -> Curves:
    """Return curves from the rows of a run: a step, and a value or nothing for each tag. Raises ValueError."""
    if not rows:
        raise ValueError("it has a run without rows")
    texts, *columns = zip(*rows, strict=True)
    steps = _numbers(texts)
    if not (np.isfinite(steps).all() and steps[0] >= 0 and steps[-1] <= LAST and (np.diff(steps) > 0).all()):
        raise ValueError("its steps do not ascend")
    values = {tag: _numbers(own).astype(np.float32) for tag, own in zip(tags, columns, strict=True) if any(own)}
    return Curves(steps.astype(np.int64), values)


def _numbers(column: Sequence[str]) -> Array:
    """Return the numbers of a column, float64, NaN for an empty cell. Raises ValueError."""
    numbers = np.array([float(text or "nan") for text in column])
    for text, number in zip(column, numbers, strict=True):
        if text and not abs(number) < BEYOND:
            raise ValueError(f"{text:.80} is not a finite number")
    return numbers


@dataclass(frozen=True)
class EndValue:
    """Mean and standard deviation of the last tenth of a curve's points; for a single point the deviation is NaN."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class MovingAverage:
    """Mean, minimum and maximum of the moving averages of runs at each number of agent-steps, all (points,)."""

    steps: Array
    mean: Array
    low: Array
    high: Array

    @property
    def peak(self) -> tuple[int, float]:
        """The agent-steps and the height of the highest point."""
        top = int(np.nanargmax(self.mean))
        return int(self.steps[top]), float(self.mean[top])


def average(runs: Sequence[Curves], tag: str, *, common: bool = False) -> MovingAverage:
    """Average the smoothed curves of the runs that have the tag (at least one), interpolated between their points.

    common: Only at points that all of these runs have, so that the average does not jump; there may be none.
    """
    curves = [one for one in runs if tag in one.values]
    steps = np.unique(np.concatenate([one.steps for one in curves]))
    every = np.full((len(curves), len(steps)), np.nan)  # NaN before the first point of a run and after its last
    for row, one in zip(every, curves, strict=True):
        values = smooth(one.values[tag])
        if (own := np.isfinite(values)).any():
            row[:] = np.interp(steps, one.steps[own], values[own], left=np.nan, right=np.nan)
    there = np.isfinite(every).all(0) if common else np.isfinite(every).any(0)
    every = every[:, there]
    return MovingAverage(steps[there], np.nanmean(every, 0), np.nanmin(every, 0), np.nanmax(every, 0))


def smooth(values: Array) -> Array:
    """Return the moving average around each point, over fewer points at both ends; NaNs are left out."""
    half = window_size(len(values)) // 2
    there = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(there, values, 0.0), dtype=np.float64)])
    counts = np.concatenate([[0], np.cumsum(there)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    with np.errstate(invalid="ignore"):
        averages: Array = (sums[last] - sums[first]) / (counts[last] - counts[first])
    return averages


def window_size(points: int) -> int:
    """Return the number of points, odd, that a moving average spans in a curve of `points` points."""
    return max(1, points // SMOOTH) | 1


def end_value(values: Array) -> EndValue:
    """Return the end value of a curve with at least one number."""
    there = values[np.isfinite(values)].astype(np.float64)
    last = there[-max(1, round(END * len(there))) :]
    return EndValue(float(last.mean()), float(last.std(ddof=1)) if len(last) > 1 else float("nan"))


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of a mean by Student's t: lower and upper end; NaN for a single value."""
    count = len(values)
    if count < 2:
        return float("nan"), float("nan")
    free = count - 1
    factor = STUDENT[free - 1] if free <= len(STUDENT) else 1.96 + 2.372 / free + 2.823 / free**2  # Cornish and Fisher
    half = factor * float(np.std(values, ddof=1)) / count**0.5
    return float(np.mean(values)) - half, float(np.mean(values)) + half
