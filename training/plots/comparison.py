"""Comparisons of `outlast plot`: groups of runs, the curves to draw, and the table of their end values."""

import hashlib
import json
import re
import warnings
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from outlast.ecs.kernels.errors import did_you_mean

from ..base.curves import Array, Curves, end_value, interval
from ..base.errors import TrainingError
from ..base.metrics import PAPER_NAMES
from ..base.quantities import SUMMED, combinable, csv_text, digits, markdown_table, number
from .runs import PRESET, SCENARIO, Run, RunGroup, common, unnamed

AXES = ("steps", "time")
ROLLOUT = "rollout/"
FIRST = ("return", "length", "kills", "heals_used")
LAST = "wins/"  # begins the names of curves that come after the statistics
RARE = ("episodes", "first_death")  # like deaths by damage type, drawn only on request
MOST = 6  # maximum curves drawn by default


@dataclass(frozen=True)
class Panel:
    """A curve to draw: its name, the tags of its log, and the meaning of several tags, such as sides."""

    name: str
    tags: tuple[str, ...]
    of: str = ""

    @property
    def title(self) -> str:
        """The name, and how several tags are combined."""
        how = f", {'sum' if self.name in SUMMED else 'mean'} over {self.of}" if len(self.tags) > 1 else ""
        return (self.name if "/" in self.name else self.name.replace("_", " ")) + how  # a tag may name a file


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
        name = common(self.runs, lambda run: run.label or run.scenario) or common(self.runs, lambda run: run.scenario)
        of_preset = f"preset {of}" if (of := common(self.runs, lambda run: str(run.plan[PRESET]))) else ""
        count = "one run" if len(self.runs) == 1 else f"{len(self.runs)} runs"
        return ", ".join(filter(None, (name, of_preset, count)))

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
        levels = (run.plan.get("levels") for group in self.groups for run in group.runs[1:])
        if choosers := sorted({str(name) for name in levels if name}):
            notes.append(f"Runs differ only in the function that chooses levels: {', '.join(choosers)}")
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
            seeds, steps = _counted(group)
            about = group.values.values() or [group.label]
            lines.append([*about, ", ".join(dict.fromkeys(seeds)), f"{steps:,}", *map(_cell, self.ends(group))])
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
            seeds, steps = _counted(group)
            for panel, ends in zip(self.panels, self.ends(group), strict=True):
                found = [float(np.mean(ends)), *interval(ends), min(ends), max(ends)] if ends else [np.nan] * 5
                about = [panel.name, len(ends), " ".join(seeds), steps]
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


def _counted(group: RunGroup) -> tuple[list[str], int]:
    """Return the seeds whose end values count, and how many agent-steps all of them have done."""
    return [str(run.seed) for run in group.ended], min(run.steps for run in group.ended)


def chosen(runs: Sequence[Run], names: Sequence[str]) -> list[Panel]:
    """Return the panels of these names or, without names, the usual ones.

    names: "length", "return" and other statistics of episodes; or tags of a log, "wins/scripted", "rollout/kills0",
    "train/entropy". Raises TrainingError: no run has one of these curves.
    """
    logs = [run.curves.values for run in runs]
    tags = list(dict.fromkeys(tag for log in logs for tag in log))
    by_name: dict[str, list[str]] = {}
    for tag in sorted(tags):
        by_name.setdefault(name_of(tag, tags), []).append(tag)
    returns = by_name.get("return", [])
    known = {name: Panel(name, tuple(own), _owners(own, returns, logs)) for name, own in by_name.items()}
    if not names:
        statistics = (name for name in known if "/" not in name and not name.startswith("deaths_"))
        rest = [name for name in statistics if name not in (*FIRST, *RARE)]
        wins = [name for name in known if name.startswith(LAST)]
        return [known[name] for name in (*FIRST, *rest, *wins) if name in known][:MOST]
    if unknown := [name for name in names if name not in known and name not in tags]:
        hint = did_you_mean(unknown[0], [*known, *tags], after=" ")
        raise TrainingError(f"these runs have no curve '{unknown[0]}'; {hint}they have: {', '.join(known)}")
    return [known.get(name) or Panel(name, (name,)) for name in names]


def _owners(own: Sequence[str], returns: Sequence[str], logs: Sequence[Collection[str]]) -> str:
    """Return the owner of each tag of a statistic: sides, as for the return, or agents if it has more tags."""
    counts = [(sum(tag in log for tag in own), sum(tag in log for tag in returns)) for log in logs]
    kinds = {"agents" if there > sides > 0 else "sides" for there, sides in counts if there > 1}
    return " or ".join(sorted(kinds))


def name_of(tag: str, tags: Sequence[str]) -> str:
    """Return the name of a tag in commands: "length" for "rollout/steps", "kills" for "rollout/kills1"; or the tag."""
    if not tag.startswith(ROLLOUT):
        return tag
    plain = re.sub(r"(0|[1-9]\d*)$", "", tag)
    several = plain != tag and f"{plain}0" in tags
    own = (plain if several else tag).removeprefix(ROLLOUT)
    return next((name for name, paper in PAPER_NAMES.items() if paper == own), own)


def drawn(run: Run, panels: Sequence[Panel]) -> Curves:
    """Return the curves of panels, by their names; missing ones are left out."""
    found = dict[str, Array]()
    for panel in panels:
        own = [run.curves.values[tag] for tag in combinable([tag for tag in panel.tags if tag in run.curves.values])]
        if any(np.isfinite(each).any() for each in own):
            with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a rollout may lack all sides
                found[panel.name] = np.sum(own, 0) if panel.name in SUMMED else np.nanmean(own, 0)  # of those present
    return Curves(run.curves.steps, found)


def hours(run: Run) -> Array | None:
    """Return the hours of training at each of the run's points, float64 (points,): by the speed that it logged.

    The hours of imitation, which comes first, are included.
    """
    speed = run.curves.values.get("time/fps")
    if speed is None:
        return None
    taken = np.diff(run.curves.steps, prepend=0) / np.where(speed > 0, speed, np.nan) / 3600
    imitation = np.nansum(run.curves.values.get("time/imitation", 0.0)) / 3600
    return np.nancumsum(taken) + imitation
