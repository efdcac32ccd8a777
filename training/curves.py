"""Learning curves from the log of a run, written to small files and read back. Needs only numpy."""

import csv
import io
import json
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.storage import strict_json

from .errors import EmptyRunError, TrainingError
from .files import read_text
from .log_file import LAST, read_log

BEYOND = 1e30  # values are below this, so that they can be squared and added up
Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Quantity:
    """A logged quantity. tag: In TensorBoard. sided: Whether each agent or team has its own: tag0, tag1 and so on."""

    name: str
    tag: str
    sided: bool = False

    def has(self, tag: str) -> bool:
        """Return whether the tag is one of this quantity's."""
        number = tag.removeprefix(self.tag)
        fits = re.fullmatch("0|[1-9][0-9]{0,3}", number) is not None if self.sided else not number
        return fits and tag.startswith(self.tag)

    def side(self, tag: str) -> int:
        """The number of the agent or team in a tag; -1 if the quantity is not sided."""
        return int(tag[len(self.tag) :]) if self.sided else -1


NEEDED = ("rollout/steps", "rollout/reward0")  # every run in which an episode has ended has them


@dataclass(frozen=True)
class Curves:
    """Curves over the same points.

    steps: agent-steps, int64 (points,), ascending. values: by tag, float32 (points,), NaN where a rollout has none.
    """

    steps: Array
    values: dict[str, Array]

    def tags(self, quantity: Quantity) -> list[str]:
        """Return the existing tags of a quantity, in order of sides."""
        return sorted((tag for tag in self.values if quantity.has(tag)), key=quantity.side)


def thinned(curves: Curves, most: int) -> Curves:
    """Reduce curves to at most `most` points, each the mean of some neighbours, at the step of the last of these."""
    starts = np.arange(0, len(curves.steps), -(-len(curves.steps) // most))
    ends = np.append(starts[1:], len(curves.steps)) - 1
    values = {tag: _means(own, starts) for tag, own in curves.values.items()}
    return Curves(curves.steps[ends], values)


def _means(values: Array, starts: Array) -> Array:
    """The means of parts that begin at `starts`, without NaN; NaN where there is nothing else."""
    there = np.isfinite(values)
    counts = np.add.reduceat(there, starts, dtype=np.float64)
    sums = np.add.reduceat(np.where(there, values, 0), starts, dtype=np.float64)
    means: Array = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).astype(np.float32)
    return means


class Logged:
    """What every run that was read has: the plan of run.json, and curves."""

    plan: dict[str, Any]
    curves: Curves

    @property
    def seed(self) -> int:
        """The seed of the run."""
        return int(self.plan["seed"])

    @property
    def steps(self) -> int:
        """The agent-steps done."""
        return int(self.curves.steps[-1])


def curves_of_log(path: Path, known: Callable[[str], bool]) -> Curves:
    """The curves in the log of a run.

    Args:
        path: log.csv of the run.
        known: Whether a tag must have finite numbers only, or the log is broken; other tags may have NaN.

    Raises:
        EmptyRunError: No episode has ended in it yet.
        TrainingError: It is no log, or has numbers that cannot be drawn.
    """
    begun = path.exists() and path.stat().st_size > 0  # else the run has not written its first row yet
    points = read_log(path) if begun else {}
    for tag in NEEDED:
        if tag not in points:
            raise EmptyRunError(f"{path} has no {tag}: no episode has ended in it yet, or no run of ours wrote it")
    for tag, rows in points.items():
        if bad := [step for step, value in rows if known(tag) and not abs(value) < BEYOND]:
            raise TrainingError(f"{path} is broken: {tag} at step {bad[0]} is not a finite number")
    steps = np.array(sorted({step for rows in points.values() for step, _ in rows}), np.int64)
    return Curves(steps, {tag: _spread(rows, steps) for tag, rows in sorted(points.items())})


def _spread(rows: list[tuple[int, float]], steps: Array) -> Array:
    """The values at all steps, NaN where there is none."""
    values = np.full(len(steps), np.nan, np.float32)
    own = [value if abs(value) < BEYOND else np.nan for _, value in rows]
    values[np.searchsorted(steps, [step for step, _ in rows])] = own
    return values


def format_curves(about: dict[str, Any], curves: Curves) -> str:
    """Write curves as the text of a CSV file: `about` as JSON in a comment, and a column for each tag.

    Numbers have the fewest digits that give the same float32.
    """
    text = io.StringIO()
    text.write(f"# {json.dumps(about)}\n")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["step", *curves.values])
    columns = [[_short(value) for value in values] for values in curves.values.values()]
    rows.writerows(zip(curves.steps.tolist(), *columns, strict=True))
    return text.getvalue()


def _short(value: Any) -> str:
    return "" if np.isnan(value) else np.format_float_positional(value, trim="-")


def read_curves(path: Path) -> tuple[dict[str, Any], Curves]:
    """Read `about` and the curves from a file of format_curves. Raises TrainingError for any other file."""
    first, _, rest = read_text(path).partition("\n")
    try:
        if not first.startswith("# "):
            raise ValueError("its first line does not describe the curves")
        about = json.loads(first[2:])
        heads, *rows = csv.reader(io.StringIO(rest), strict=True)
        return about, _columns(heads, rows)
    except (*strict_json.BROKEN, csv.Error) as error:
        raise TrainingError(f"{path} does not hold the curves of a run: {error}") from None


def _columns(heads: list[str], rows: Iterable[list[str]]) -> Curves:
    """Make curves of a table of texts. Raises ValueError."""
    lines = list(rows)
    for number, row in enumerate(lines, 3):
        if len(row) != len(heads):
            raise ValueError(f"line {number} has {len(row)} cells, and the heading {len(heads)}: was it cut off?")
    columns = list(zip(*lines, strict=True))
    if heads[:1] != ["step"] or len(columns) != len(heads) or len(set(heads)) < len(heads):
        raise ValueError("its columns are not step and tags, or it has no rows")
    steps, *values = (np.array(list(_numbers(column)), np.float64) for column in columns)
    if not (np.isfinite(steps).all() and steps[0] >= 0 and steps[-1] <= LAST and (np.diff(steps) > 0).all()):
        raise ValueError("its steps do not ascend")
    return Curves(steps.astype(np.int64), {tag: value.astype(np.float32) for tag, value in zip(heads[1:], values)})


def _numbers(column: Iterable[str]) -> Iterator[float]:
    """Yield the numbers of a column, NaN for an empty cell. Raises ValueError, also if all cells are empty."""
    if not any(column):
        raise ValueError("a column is empty")
    for text in column:
        number = float(text or "nan")
        if text and not abs(number) < BEYOND:
            raise ValueError(f"{text:.80} is not a finite number")
        yield number
