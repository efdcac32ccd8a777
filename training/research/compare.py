"""compare: runs of the paper's variants beside the paper's: figures, end values and peaks, and claims, as tables."""

import argparse
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.api.options import OUTPUT
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import output
from outlast.envs.errors import needed

from ..base.curves import KILLS, LENGTH, QUANTITIES, RETURN, EndValue, Quantity, average, end_value
from ..base.errors import TrainingError
from ..base.files import check_out, write_files
from ..base.quantities import ENDS, csv_text, decimals, digits, markdown_table, number, spread, with_spread
from ..plots.plot import DRAWN, FORMS
from .claims import claims_table, findings
from .results import PaperGroup, files_to_keep, group_runs, load_runs

PAPER = "the paper"
TOLERANCE = 0.15  # relative: returns and lengths within it agree with the paper's end value
WITHIN = f"within {TOLERANCE:.0%}"
HEADS = ("", PAPER, "outlast", "95 %", "apart", WITHIN, "peak in the paper", "peak in outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "compare", run)
    text = "folder of a run, or a folder with several of these, or with kept results"
    command.group(DRAWN).add_argument("runs", nargs="+", type=Path, metavar="RUN", help=text)
    group = command.group(OUTPUT)
    text = "folder for figures and tables (default figures)"
    group.add_argument("--out", type=output(check_out), default="figures", metavar="FOLDER", help=text)
    group.add_argument("--format", choices=FORMS, default=FORMS[0], help=f"format of the figures (default {FORMS[0]})")
    text = "also write the runs' curves, and newest policies as RUN.safetensors, to this folder"
    group.add_argument("--keep", type=output(check_out), metavar="FOLDER", help=text)


def run(options: argparse.Namespace) -> None:
    """Compare runs of the paper's variants with the paper.

    Draw a figure for each variant and preset, beside the paper's curves, and check the paper's claims.

    Examples:
        compare runs --out figures/paper  # all runs in a folder
    """
    runs = load_runs(options.runs)
    groups = group_runs(runs)
    contents = files_to_keep(runs, Path(options.keep)) if options.keep else {}
    drawn = figures_and_tables(groups, options.format)
    contents |= {Path(options.out) / name: content for name, content in drawn.items()}
    write_files(contents)  # nothing, if a run is invalid
    print(report(groups), *contents, sep="\n")


@dataclass(frozen=True)
class EndRow:
    """A quantity of a group: end values and peaks of its runs, and those of the paper's."""

    group: PaperGroup
    quantity: Quantity
    side: int  # -1 for all agents together
    ours: tuple[EndValue, ...]  # one for each run whose end value counts, in order of seeds
    peak: tuple[int, float]  # of the moving average: agent-steps and height
    theirs: EndValue | None  # None if the paper lacks the quantity
    their_peak: tuple[int, float] | None

    @property
    def means(self) -> list[float]:
        """The end value of each run."""
        return [each.mean for each in self.ours]

    @property
    def end(self) -> EndValue:
        """The mean over seeds, and the deviation between points of a run: the mean over seeds."""
        return EndValue(float(np.mean(self.means)), float(np.mean([each.deviation for each in self.ours])))

    @property
    def apart(self) -> float | None:
        """Our end value over the paper's, less 1; None for quantities near 0, where it means little."""
        if self.theirs is None or self.quantity not in (RETURN, LENGTH) or not self.theirs.mean:
            return None
        return self.end.mean / self.theirs.mean - 1

    @property
    def verdict(self) -> str:
        """The agreement of the end values: "yes", "no", "too early"; "" if unchecked."""
        if self.apart is None or self.group.ablated:
            return ""
        if len(self.group.unfinished) == len(self.group.runs):
            return "too early"
        return "yes" if abs(self.apart) <= TOLERANCE else "no"


def rows(group: PaperGroup) -> Iterator[EndRow]:
    """Yield a row for each curve of the group's runs."""
    for quantity in QUANTITIES:
        for tag in group.runs[0].curves.tags(quantity):
            curves = [run.curves for run in group.ended if tag in run.curves.values]
            ours, peak = tuple(end_value(each.values[tag]) for each in curves), average(curves, tag).peak
            there = tag in group.paper.values
            theirs = (end_value(group.paper.values[tag]), average([group.paper], tag).peak) if there else (None, None)
            yield EndRow(group, quantity, quantity.side(tag), ours, peak, *theirs)


def markdown(group: PaperGroup) -> str:
    """Return the end values of a group: a paragraph with variant, preset, seeds and notes, and a table."""
    seeds = ", ".join(str(run.seed) for run in group.runs)
    notes = "".join(f" {note}." for note in group.notes())
    title = f"`{group.variant}`, preset `{group.preset}`, seed{'s' * (len(group.runs) > 1)} {seeds}.{notes}"
    return f"{title}\n\n{markdown_table(HEADS, map(_cells, rows(group)))}"


def _cells(row: EndRow) -> list[str]:
    return [
        row.quantity.name + (f", {row.group.side} {row.side}" if row.side >= 0 else ""),
        _with_deviation(row.theirs) if row.theirs else "",
        _with_deviation(row.end),
        spread(row.means),
        "" if row.apart is None else f"{row.apart:+.0%}".replace("-", "−"),
        row.verdict,
        *(f"{number(peak[1])} at {peak[0] / 1e6:.1f} M" if peak else "" for peak in (row.their_peak, row.peak)),
    ]


def _with_deviation(value: EndValue) -> str:
    """Format mean ± deviation, with the same digits; only the mean if the scatter of points is unknown."""
    scatter = "" if np.isnan(value.deviation) else f" ± {value.deviation:,.{decimals(value.mean)}f}"
    return number(value.mean) + scatter


def csv_table(groups: Iterable[PaperGroup]) -> str:
    """Return the table as CSV, with a row for each quantity and all meaningful digits."""
    records = [_record(row) for group in groups for row in rows(group)]
    return csv_text(list(records[0]), (record.values() for record in records))


def _record(row: EndRow) -> dict[str, Any]:
    group, theirs, end = row.group, row.theirs or EndValue(np.nan, np.nan), row.end
    return {
        "variant": group.variant,
        "preset": group.preset,
        "quantity": row.quantity.name,
        "agent or team": row.side if row.side >= 0 else "",
        "seeds": " ".join(str(run.seed) for run in group.ended),
        "agent-steps": min(run.steps for run in group.ended),
        "paper": digits(theirs.mean),
        "paper between points": digits(theirs.deviation),
        "outlast": digits(end.mean),
        "outlast between points": digits(end.deviation),
        "lowest seed": digits(min(row.means)),
        "highest seed": digits(max(row.means)),
        "apart": "" if row.apart is None else f"{row.apart:.4f}",
        WITHIN: row.verdict,
        "paper's peak": digits(row.their_peak[1]) if row.their_peak else "",
        "paper's peak at": row.their_peak[0] if row.their_peak else "",
        "outlast's peak": digits(row.peak[1]),
        "outlast's peak at": row.peak[0],
    }


def side_by_side(groups: Sequence[PaperGroup]) -> str:
    """Return the end values of every variant, with all presets and 95 % intervals over seeds, in Markdown.

    Values of sides are averaged; kills are summed.
    """
    presets = list(dict.fromkeys(group.preset for group in groups))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for group in groups:
        for quantity, same in itertools.groupby(rows(group), key=lambda row: row.quantity):
            own = list(same)
            sides = 1 if quantity == KILLS else len(own)
            line = cells.setdefault((group.variant, quantity.name), {})
            line[group.preset] = with_spread([sum(each) / sides for each in zip(*(row.means for row in own))])
            if own[0].theirs:
                line[PAPER] = number(sum(row.theirs.mean for row in own if row.theirs) / sides)
    heads = ("variant", "at the end", PAPER, *(f"preset `{name}`" for name in presets))
    lines = [[*key, *(line.get(name, "") for name in (PAPER, *presets))] for key, line in sorted(cells.items())]
    return markdown_table(heads, lines)


def report(groups: Sequence[PaperGroup], beside: Sequence[PaperGroup] = ()) -> str:
    """Return the end values of all presets side by side, those of each group, and the paper's claims, in Markdown."""
    parts = [markdown(group) for group in groups]
    if len({group.preset for group in (*beside, *groups)}) > 1:
        parts.insert(0, side_by_side([*beside, *groups]))
    for name in dict.fromkeys(group.preset for group in groups):
        if found := list(findings([group for group in groups if group.preset == name])):
            parts.append(f"What the paper says, and runs of preset `{name}`:\n\n{claims_table(found)}")
    return "\n\n".join(parts) + "\n"


def figures_and_tables(groups: Sequence[PaperGroup], form: str, beside: Sequence[PaperGroup] = ()) -> dict[str, bytes]:
    """Return the contents of all files, by name: the figures, the tables in Markdown, and the end values as CSV.

    beside: Runs with other presets, for the table of all presets. Raises TrainingError: matplotlib is missing.
    """
    with needed("plot", "figures need {}", TrainingError):
        from .figures import picture
    figures = {f"{group.name}.{form}": picture(group, form) for group in groups}
    return {**figures, "ends.md": report(groups, beside).encode(), ENDS: csv_table(groups).encode()}
