"""End values and peaks of moving averages, and their table beside the paper's, as Markdown and as CSV."""

import csv
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.averages import EndValue, MovingAverage, average, end_value
from ..base.curves import LENGTH, QUANTITIES, RETURN, Quantity
from ..base.tables import decimals, markdown_table, number, spread
from .results import PaperGroup

TOLERANCE = 0.15  # returns and lengths that are no further from the paper's end value agree with it
WITHIN = f"within {TOLERANCE:.0%}"
HEADS = ("", "the paper", "outlast", "95 %", "apart", WITHIN, "peak in the paper", "peak in outlast")


@dataclass(frozen=True)
class EndRow:
    """A quantity of a group: end values and moving averages of its runs and of the paper's, which may have none.

    side: -1 if it is of all agents. ours: One for each run whose end value counts, in order of seeds.
    """

    quantity: Quantity
    side: int
    ours: tuple[EndValue, ...]
    curve: MovingAverage
    theirs: EndValue | None
    their_curve: MovingAverage | None

    @property
    def mean(self) -> float:
        """The mean over seeds."""
        return float(np.mean([each.mean for each in self.ours]))

    @property
    def deviation(self) -> float:
        """The deviation between points of a run: the mean over seeds."""
        return float(np.mean([each.deviation for each in self.ours]))

    @property
    def apart(self) -> float | None:
        """Our end value over the paper's, less 1; None for quantities near 0, for which it means little."""
        if self.theirs is None or self.quantity not in (RETURN, LENGTH) or not self.theirs.mean:
            return None
        return self.mean / self.theirs.mean - 1


def rows(group: PaperGroup) -> Iterator[EndRow]:
    """A row for each curve of the group's runs."""
    for quantity in QUANTITIES:
        for tag in group.runs[0].curves.tags(quantity):
            ours = [run.curves for run in group.ended if tag in run.curves.values]
            theirs = [group.paper] if tag in group.paper.values else []
            yield EndRow(
                quantity,
                quantity.side(tag),
                tuple(end_value(curves.values[tag]) for curves in ours),
                average(ours, tag),
                *((end_value(group.paper.values[tag]), average(theirs, tag)) if theirs else (None, None)),
            )


def verdict(group: PaperGroup, row: EndRow) -> str:
    """Whether the end values agree: "yes", "no", "too early"; empty where that is not checked."""
    if row.apart is None or group.ablated:
        return ""
    if not all(run.done for run in group.ended):
        return "too early"
    return "yes" if abs(row.apart) <= TOLERANCE else "no"


def side_name(group: PaperGroup) -> str:
    """What a side is called: "team" or "agent"."""
    return "team" if group.variant.startswith("teams") else "agent"


def markdown(group: PaperGroup) -> str:
    """The end values of a group: a paragraph and a table."""
    return f"{title(group)}\n\n{markdown_table(HEADS, _cells(group))}"


def title(group: PaperGroup) -> str:
    """Variant, preset, seeds, and the notes."""
    seeds = ", ".join(str(run.seed) for run in group.runs)
    notes = "".join(f" {note}." for note in group.notes())
    return f"`{group.variant}`, preset `{group.preset}`, seed{'s' * (len(group.runs) > 1)} {seeds}.{notes}"


def _cells(group: PaperGroup) -> Iterator[list[str]]:
    for row in rows(group):
        name = row.quantity.name + (f", {side_name(group)} {row.side}" if row.side >= 0 else "")
        yield [
            name,
            with_deviation(row.theirs.mean, row.theirs.deviation) if row.theirs else "",
            with_deviation(row.mean, row.deviation),
            spread([one.mean for one in row.ours]),
            "" if row.apart is None else f"{row.apart:+.0%}".replace("-", "−"),
            verdict(group, row),
            _peak(row.their_curve),
            _peak(row.curve),
        ]


def _peak(curve: MovingAverage | None) -> str:
    return f"{number(curve.peak[1])} at {curve.peak[0] / 1e6:.1f} M" if curve else ""


def with_deviation(mean: float, deviation: float) -> str:
    """Mean ± deviation, with the same digits; the mean alone if it is not known how far points scatter."""
    return number(mean) + ("" if np.isnan(deviation) else f" ± {deviation:,.{decimals(mean)}f}")


def csv_table(groups: Iterable[PaperGroup]) -> str:
    """The table as CSV, with a row for each quantity and all digits that mean something."""
    records = [record(group, row) for group in groups for row in rows(group)]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def record(group: PaperGroup, row: EndRow) -> dict[str, Any]:
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
        WITHIN: verdict(group, row),
        "paper's peak": _digits(curve.peak[1] if curve else None),
        "paper's peak at": curve.peak[0] if curve else "",
        "outlast's peak": _digits(row.curve.peak[1]),
        "outlast's peak at": row.curve.peak[0],
    }


def _digits(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else f"{value:.6g}"
