"""Comparisons of `outlast plot`: groups of runs, their curves, and the table of their end values."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.curves import end_value, interval
from ..base.quantities import csv_text, digits, markdown_table, number
from .groups import RunGroup, common, unnamed
from .panels import Panel, drawn
from .runs import PRESET, SCENARIO, Run

AXES = ("steps", "time")


@dataclass(frozen=True)
class Comparison:
    """Runs to compare; `str(comparison)` is a table of their end values in Markdown.

    Attributes:
        groups: Groups of runs that differ by seeds, in order.
        panels: The curves.
        x: Quantity of the horizontal axis, one of AXES.
        files: Paths of the files written.
    """

    groups: tuple[RunGroup, ...]
    panels: tuple[Panel, ...]
    x: str = "steps"
    files: list[Path] = field(default_factory=list)

    @property
    def runs(self) -> list[Run]:
        """All runs."""
        return [run for group in self.groups for run in group.runs]

    @property
    def title(self) -> str:
        """Return the settings that all runs share, and the number of runs."""
        parts = [
            common(self.runs, lambda run: run.label or run.scenario) or common(self.runs, lambda run: run.scenario)
        ]
        parts += [f"preset {name}"] if (name := common(self.runs, lambda run: str(run.plan[PRESET]))) else []
        count = len(self.runs)
        return ", ".join([*filter(None, parts), "one run" if count == 1 else f"{count} runs"])

    @property
    def faint(self) -> bool:
        """Return whether the figure has room for the points of single runs."""
        return len(self.groups) <= 3

    @property
    def drawn_how(self) -> str:
        """A description of the curves and bands."""
        several = any(len(group.runs) > 1 for group in self.groups)
        single = any(len(group.runs) == 1 for group in self.groups)
        longer = any(len({run.steps for run in group.runs}) > 1 for group in self.groups)
        over = "means over the runs that are this long" if longer else "means over runs"
        if self.x == "time":
            over = "means over runs, up to the end of the shortest"
        parts = ["Lines: moving averages over 5 % of the points" + f", {over}" * several]
        parts += ["bands: from the lowest to the highest run"] * several
        if single and self.faint:
            parts.append("faint: points of single runs" if several else "faint: all points")
        return "; ".join(parts)

    def notes(self) -> list[str]:
        """Return notes for the reader: runs averaged although they differ, and unfinished runs."""
        notes = [f"{group.label}: averaged over {', '.join(group.mixed)}, too" for group in self.groups if group.mixed]
        given = {*self.groups[0].values, *(name for group in self.groups for name in group.mixed)}
        notes += [f"Groups differ in {', '.join(others)}, too"] if (others := unnamed(self.runs, given)) else []
        later = [run for group in self.groups for run in group.runs[1:]]
        choosers = {str(run.plan["levels"]) for run in later if run.plan.get("levels")}
        notes += [f"Runs differ only in the function that chooses levels: {', '.join(sorted(choosers))}"] * bool(
            choosers
        )
        short = [run for group in self.groups for run in group.unfinished]
        named = ", ".join(f"{run.origin.name} ({run.steps:,} agent-steps)" for run in short[:4])
        more = f" and {len(short) - 4} more" if len(short) > 4 else ""
        unfinished = f"Unfinished: {named}{more}; end values are of the finished runs of a group that has any"
        return [*notes, unfinished] if short else notes

    def ends(self, group: RunGroup) -> Iterator[tuple[float, ...]]:
        """Yield, for each curve, its end value in each counted run of a group that has it, in order of seeds."""
        curves = [drawn(run, self.panels) for run in group.ended]
        for panel in self.panels:
            yield tuple(end_value(one.values[panel.name]).mean for one in curves if panel.name in one.values)

    def __str__(self) -> str:
        names = [*self.groups[0].values] or [SCENARIO]
        heads = [*names, "seeds", "agent-steps", *(panel.title for panel in self.panels)]
        lines = []
        for group in self.groups:
            about = *(group.values.values() or [group.label]), ", ".join(dict.fromkeys(_seeds(group)))
            lines.append([*about, f"{_steps(group):,}", *map(_cell, self.ends(group))])
        means = "End values: the mean of the last tenth of each run"
        several = any(len(group.ended) > 1 for group in self.groups)
        within = ", then over runs [95 % interval of that mean, by Student's t]" * several
        notes = "".join(f" {note}." for note in self.notes())
        return f"{self.title}. {means}{within}.{notes}\n\n{markdown_table(heads, lines)}\n"

    def csv(self) -> str:
        """Return the table with all significant digits, with a row for each group and curve."""
        heads = "curve", "runs", "seeds", "agent-steps", "mean", "low 95 %", "high 95 %", "lowest", "highest"
        rows = list[list[object]]()
        for group in self.groups:
            for panel, ends in zip(self.panels, self.ends(group), strict=True):
                found = [float(np.mean(ends)), *interval(ends), min(ends), max(ends)] if ends else [np.nan] * 5
                about = [panel.name, len(ends), " ".join(_seeds(group)), _steps(group)]
                rows.append([*group.values.values(), *about, *map(digits, found)])
        return csv_text([*self.groups[0].values, *heads], rows)

    def digest(self) -> str:
        """Return a digest of the content of the figure."""
        total = hashlib.blake2b(f"{self.title} {self.x}".encode(), digest_size=16)
        for group in self.groups:
            total.update(json.dumps([group.label, group.mixed]).encode())
            for curves in (drawn(run, self.panels) for run in group.runs):
                total.update(curves.steps.tobytes())
                for name, values in curves.values.items():
                    total.update(name.encode() + values.tobytes())
        return total.hexdigest()


def _cell(ends: Sequence[float]) -> str:
    """Return the mean over runs, with its 95 % interval if there are several."""
    if not ends:
        return ""
    low, high = interval(ends)
    return number(float(np.mean(ends))) + ("" if np.isnan(low) else f" [{number(low)}, {number(high)}]")


def _seeds(group: RunGroup) -> list[str]:
    return [str(run.seed) for run in group.ended]


def _steps(group: RunGroup) -> int:
    return min(run.steps for run in group.ended)
