"""The table of end values beside the paper's, as Markdown and as CSV."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .curves import LENGTH, QUANTITIES, RETURN, Quantity
from .endings import CLOSE, Average, Ending, average, ending
from .results import Group

HEADS = ("", "the paper", "outlast", "seeds", "apart", f"within {CLOSE:.0%}", "peak in the paper", "peak in outlast")


@dataclass(frozen=True)
class Row:
    """A quantity of a group: ends of its runs and of the paper's, and their curves; the paper may have none.

    ours: of each run whose end counts, in order of seeds. side: -1 if it is of all.
    """

    quantity: Quantity
    side: int
    ours: tuple[Ending, ...]
    curve: Average
    theirs: Ending | None
    their_curve: Average | None

    @property
    def mean(self) -> float:
        """Over seeds."""
        return float(np.mean([each.mean for each in self.ours]))

    @property
    def deviation(self) -> float:
        """Between points of a run; the mean over seeds."""
        return float(np.mean([each.deviation for each in self.ours]))

    @property
    def apart(self) -> float | None:
        """Our end over the paper's, less 1; None for quantities that this says little of: those near 0."""
        if self.theirs is None or self.quantity not in (RETURN, LENGTH) or not self.theirs.mean:
            return None
        return self.mean / self.theirs.mean - 1


def rows(group: Group) -> Iterator[Row]:
    """A row for each curve of the group's runs."""
    for quantity in QUANTITIES:
        for tag in group.runs[0].curves.tags(quantity):
            ours = [run.curves for run in group.ended if tag in run.curves.values]
            theirs = [group.paper] if tag in group.paper.values else []
            yield Row(
                quantity,
                quantity.side(tag),
                tuple(ending(curves.values[tag]) for curves in ours),
                average(ours, tag),
                *((ending(group.paper.values[tag]), average(theirs, tag)) if theirs else (None, None)),
            )


def verdict(group: Group, row: Row) -> str:
    """Whether the ends are close: yes, no, or that it is too early to say; empty where it is not asked."""
    if row.apart is None or group.mended:
        return ""
    if not all(run.done for run in group.ended):
        return "too early"
    return "yes" if abs(row.apart) <= CLOSE else "no"


def sides(group: Group) -> str:
    """What a side is called."""
    return "team" if group.variant.startswith("teams") else "agent"


def markdown(group: Group) -> str:
    """A paragraph and a table."""
    return f"{title(group)}\n\n{_grid(HEADS, _cells(group))}"


def title(group: Group) -> str:
    """What was run."""
    seeds = ", ".join(str(run.seed) for run in group.runs)
    told = "".join(f" {note}." for note in group.notes())
    return f"`{group.variant}`, preset `{group.preset}`, seed{'s' * (len(group.runs) > 1)} {seeds}.{told}"


def _cells(group: Group) -> Iterator[list[str]]:
    for row in rows(group):
        name = row.quantity.name + (f", {sides(group)} {row.side}" if row.side >= 0 else "")
        each = [one.mean for one in row.ours]
        yield [
            name,
            both(row.theirs.mean, row.theirs.deviation) if row.theirs else "",
            both(row.mean, row.deviation),
            f"{number(min(each))} to {number(max(each))}" if len(each) > 1 else "",
            "" if row.apart is None else f"{row.apart:+.0%}".replace("-", "−"),
            verdict(group, row),
            _peak(row.their_curve),
            _peak(row.curve),
        ]


def _peak(curve: Average | None) -> str:
    return f"{number(curve.peak[1])} at {curve.peak[0] / 1e6:.1f} M" if curve else ""


def both(mean: float, deviation: float) -> str:
    """With the same digits."""
    return f"{number(mean)} ± {deviation:,.{_digits_of(mean)}f}"


def number(value: float) -> str:
    """With as many digits as say something."""
    return f"{value:,.{_digits_of(value)}f}"


def _digits_of(value: float) -> int:
    """Behind the point."""
    return sum(abs(value) < bound for bound in (100, 10, 1))


def _grid(heads: Sequence[str], lines: Iterable[list[str]]) -> str:
    """A table in Markdown, numbers to the right, without the columns that have nothing in them."""
    table = list(lines)
    kept = [k for k in range(len(heads)) if k == 0 or any(line[k] for line in table)]
    every = [list(heads), ["---", *["---:"] * (len(heads) - 1)], *table]
    return "\n".join("| " + " | ".join(line[k] for k in kept) + " |" for line in every)


def table(groups: Iterable[Group]) -> str:
    """The same as CSV, a row a quantity, with all digits that mean something."""
    records = [record(group, row) for group in groups for row in rows(group)]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def record(group: Group, row: Row) -> dict[str, Any]:
    """A row of the CSV file."""
    theirs, curve, each = row.theirs, row.their_curve, [one.mean for one in row.ours]
    return {
        "variant": group.variant,
        "preset": group.preset,
        "quantity": row.quantity.name,
        "agent or team": row.side if row.side >= 0 else "",
        "seeds": " ".join(str(run.seed) for run in group.ended),
        "agent-steps": min(run.steps for run in group.ended),
        "paper": _digits(theirs.mean if theirs else None),
        "paper between points": _digits(theirs.deviation if theirs else None),
        "outlast": _digits(row.mean),
        "outlast between points": _digits(row.deviation),
        "lowest seed": _digits(min(each)),
        "highest seed": _digits(max(each)),
        "apart": "" if row.apart is None else f"{row.apart:.4f}",
        f"within {CLOSE:.0%}": verdict(group, row),
        "paper's peak": _digits(curve.peak[1] if curve else None),
        "paper's peak at": curve.peak[0] if curve else "",
        "outlast's peak": _digits(row.curve.peak[1]),
        "outlast's peak at": row.curve.peak[0],
    }


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
