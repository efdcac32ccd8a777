"""What `outlast plot` compares: groups of runs, their curves, and the table of their end values."""

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.averages import end_value, interval
from ..base.tables import markdown_table, number
from .groups import RunGroup, common, untold
from .panels import Panel, drawn
from .runs import PRESET, SCENARIO, Run

AXES = ("steps", "time")


@dataclass(frozen=True)
class EndValues:
    """The end values of a curve in a group: for each run, the mean of the last tenth of its points.

    each: A value for each run that counts, in order of seeds; empty if none has the curve.
    """

    panel: Panel
    each: tuple[float, ...]

    @property
    def mean(self) -> float:
        """The mean over runs."""
        return float(np.mean(self.each))

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the mean; NaN for a single run."""
        return interval(self.each)

    def __str__(self) -> str:
        if not self.each:
            return ""
        low, high = self.interval
        return number(self.mean) + ("" if np.isnan(low) else f" [{number(low)}, {number(high)}]")


@dataclass(frozen=True)
class Comparison:
    """Runs to compare; `str(comparison)` is a table of their end values in Markdown.

    Attributes:
        groups: Groups of runs that differ by seeds, in order.
        panels: The curves.
        x: What they are drawn over, one of AXES.
        files: The paths of the files that were written.
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
        """What all runs have in common, and how many runs there are."""
        parts = [
            common(self.runs, lambda run: run.label or run.scenario) or common(self.runs, lambda run: run.scenario)
        ]
        parts += [f"preset {name}"] if (name := common(self.runs, lambda run: str(run.plan[PRESET]))) else []
        count = len(self.runs)
        return ", ".join([*filter(None, parts), "one run" if count == 1 else f"{count} runs"])

    @property
    def faint(self) -> bool:
        """Whether the figure has room for the points of single runs."""
        return len(self.groups) <= 3

    @property
    def drawn_how(self) -> str:
        """A description of how curves are drawn."""
        several = any(len(group.runs) > 1 for group in self.groups)
        single = any(len(group.runs) == 1 for group in self.groups)
        longer = any(len({run.steps for run in group.runs}) > 1 for group in self.groups)
        over = "means over the runs that have come so far" if longer else "means over runs"
        if self.x == "time":
            over = "means over runs, to where the first of them ends"
        parts = ["Lines: moving averages over 5 % of the points" + f", {over}" * several]
        parts += ["bands: from the lowest to the highest run"] * several
        if single and self.faint:
            parts.append("faint: points of single runs" if several else "faint: all points")
        return "; ".join(parts)

    def notes(self) -> list[str]:
        """Sentences about what a reader must know: runs averaged although they differ, and unfinished runs."""
        notes = [f"{group.label}: averaged over {', '.join(group.mixed)}, too" for group in self.groups if group.mixed]
        told = {*self.groups[0].values, *(name for group in self.groups for name in group.mixed)}
        notes += [f"Groups differ in {', '.join(unsaid)}, too"] if (unsaid := untold(self.runs, told)) else []
        later = [run for group in self.groups for run in group.runs[1:]]
        choosers = {str(run.plan["levels"]) for run in later if run.plan.get("levels")}
        notes += [f"Runs are told apart by the name of what chooses levels only: {', '.join(sorted(choosers))}"] * bool(
            choosers
        )
        short = [run for group in self.groups for run in group.unfinished]
        named = ", ".join(f"{run.origin.name} ({run.steps:,} agent-steps)" for run in short[:4])
        more = f" and {len(short) - 4} more" if len(short) > 4 else ""
        unfinished = f"Unfinished: {named}{more}; end values are of the finished runs of a group that has any"
        return [*notes, unfinished] if short else notes

    def ends(self, group: RunGroup) -> Iterator[EndValues]:
        """Yield the end values of a group, for each curve."""
        curves = [drawn(run, self.panels) for run in group.ended]
        for panel in self.panels:
            values = [one.values[panel.name] for one in curves if panel.name in one.values]
            yield EndValues(panel, tuple(end_value(each).mean for each in values))

    def __str__(self) -> str:
        names = [*self.groups[0].values] or [SCENARIO]
        heads = [*names, "seeds", "agent-steps", *(panel.title for panel in self.panels)]
        lines = [[*_values(group), _seeds(group), _steps(group), *map(str, self.ends(group))] for group in self.groups]
        means = "End values: the mean of the last tenth of each run"
        several = any(len(group.ended) > 1 for group in self.groups)
        within = ", then over runs [95 % interval of that mean, by Student's t]" * several
        notes = "".join(f" {note}." for note in self.notes())
        return f"{self.title}. {means}{within}.{notes}\n\n{markdown_table(heads, lines)}\n"

    def csv(self) -> str:
        """Return the table with all significant digits, with a row for each group and curve."""
        text = io.StringIO()
        names = list(self.groups[0].values)
        heads = [*names, "curve", "runs", "seeds", "agent-steps", "mean", "low 95 %", "high 95 %", "lowest", "highest"]
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(heads)
        for group in self.groups:
            seeds = " ".join(str(run.seed) for run in group.ended)
            steps = min(run.steps for run in group.ended)
            for end in self.ends(group):
                found = (end.mean, *end.interval, min(end.each), max(end.each)) if end.each else (float("nan"),) * 5
                numbers = ["" if np.isnan(value) else f"{value:.6g}" for value in found]
                rows.writerow([*group.values.values(), end.panel.name, len(end.each), seeds, steps, *numbers])
        return text.getvalue()

    def digest(self) -> str:
        """Return a digest of what the figure shows."""
        total = hashlib.blake2b(f"{self.title} {self.x}".encode(), digest_size=16)
        for group in self.groups:
            total.update(json.dumps([group.label, group.mixed]).encode())
            for curves in (drawn(run, self.panels) for run in group.runs):
                total.update(curves.steps.tobytes())
                for name, values in curves.values.items():
                    total.update(name.encode() + values.tobytes())
        return total.hexdigest()


def _values(group: RunGroup) -> list[str]:
    return [*group.values.values()] or [group.label]


def _seeds(group: RunGroup) -> str:
    return ", ".join(dict.fromkeys(str(run.seed) for run in group.ended))


def _steps(group: RunGroup) -> str:
    return f"{min(run.steps for run in group.ended):,}"
