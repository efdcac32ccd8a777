"""Curves of several groups of runs in one figure, with a panel for each quantity. Needs matplotlib."""

import re
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..base.averages import average
from ..base.curves import Array, Curves
from ..base.image import GREY, encoded, literal
from ..base.run_summary import RATING
from .comparison import Comparison
from .groups import RunGroup
from .panels import drawn, hours

WIDTH, PANEL = 7.6, 2.35  # inches: of the figure; height of a row of panels
COLUMNS, BESIDE = 2, 4  # in a row, at most: panels; entries of the legend
LINE = 125  # characters of a line of a note
STEPS = ((1e6, "million agent-steps"), (1e3, "thousand agent-steps"), (1.0, "agent-steps"))
HOURS = ((1.0, "hours of training"), (1 / 60, "minutes of training"), (1 / 3600, "seconds of training"))
ROW, LETTER = 0.2, 0.085  # inches: height of a line of text, width of a letter in the legend
# Colours of Okabe and Ito, which people with any colour vision can tell apart, also in grey; without their yellow.
INKS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
DASHES = ("-", (0, (3.5, 1.4)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)))


def picture(comparison: Comparison, form: str) -> bytes:
    """Return the figure as the content of a file, "png" or "svg"; the same runs give the same bytes."""
    about = {"Title": comparison.title, "Source": comparison.digest()}
    return encoded(lambda: draw(comparison), form, about, colours=256)


def draw(comparison: Comparison) -> Figure:
    """Draw a row of panels for every two quantities, under a heading with the legend."""
    panels = comparison.panels
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    head = _Head(comparison)
    height = head.height + rows * PANEL + 0.3
    figure = Figure(figsize=(WIDTH, height))
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    top, bottom = 1 - (head.height + 0.25) / height, 0.5 / height
    figure.subplots_adjust(left=0.085, right=0.972, bottom=bottom, top=top, hspace=0.34, wspace=0.2)
    longest, scale, unit = _axis(comparison)
    for axes, panel in zip(grid.flat, panels, strict=False):
        axes.set_title(literal(panel.title))
        axes.set_xlim(0, longest)
        for k, group in enumerate(comparison.groups):
            _curve(axes, comparison, group, panel.name, k, scale)
        _finish(axes, from_0=not panel.name.startswith(RATING))
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    for axes in grid.flat[max(0, len(panels) - columns) : len(panels)]:
        axes.set_xlabel(unit)
    head.write(figure, height)
    return figure


def look(number: int) -> tuple[str, Any]:
    """Return colour and dashes of a group; when the colours begin again, the dashes are different."""
    return INKS[number % len(INKS)], DASHES[number // len(INKS) % len(DASHES)]


def _curve(axes: Axes, comparison: Comparison, group: RunGroup, name: str, number: int, scale: float) -> None:
    """The moving average over the runs of a group; behind it the points of a single run, or the range of several."""
    curves = [Curves(where / scale, own) for where, own in _curves(comparison, group) if name in own]
    if not curves:
        return
    line, (ink, dash) = average(curves, name, common=comparison.x == "time"), look(number)
    if not len(line.steps):  # one has ended before another has begun
        return
    marker = "o" if len(line.steps) == 1 else ""
    axes.plot(line.steps, line.mean, color=ink, linewidth=1.7, linestyle=dash, marker=marker, markersize=4, zorder=3)
    if len(curves) > 1:
        axes.fill_between(line.steps, line.low, line.high, color=ink, alpha=0.16, linewidth=0, zorder=1)
    elif comparison.faint:
        axes.plot(curves[0].steps, curves[0].values[name], color=ink, linewidth=0.5, alpha=0.3, zorder=1)


def _curves(comparison: Comparison, group: RunGroup) -> Iterator[tuple[Array, dict[str, Array]]]:
    """Where the points of each run are on the axis, agent-steps or hours, and its curves there."""
    for run in group.runs:
        where = run.curves.steps if comparison.x == "steps" else hours(run)
        if where is not None:
            yield where, drawn(run, comparison.panels).values


def _axis(comparison: Comparison) -> tuple[float, float, str]:
    """Where the axis ends, what its values are divided by, so that its numbers are short, and its label."""
    if comparison.x == "steps":
        longest = float(max(run.steps for run in comparison.runs))
        units = STEPS
    else:
        longest = max(min(float(where[-1]) for where, _ in _curves(comparison, each)) for each in comparison.groups)
        units = HOURS
    scale, name = next((pair for pair in units if longest >= pair[0]), units[-1])
    return longest / scale, scale, name


def _finish(axes: Axes, *, from_0: bool) -> None:
    """Let heights begin at 0 if nothing is below; but not those of ratings, of which only differences mean anything."""
    _, high = axes.get_ylim()
    lines = [np.asarray(line.get_ydata(), float) for line in axes.lines]
    if from_0 and lines and min(np.nanmin(line) for line in lines) >= 0:
        top = max(high, 1.05 * max(np.nanmax(line) for line in lines))
        axes.set_ylim(0, top if top > 0 else 1)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.tick_params(length=0)


class _Head:
    """Title, notes and legend, above the panels."""

    def __init__(self, comparison: Comparison) -> None:
        self.comparison = comparison
        notes = [comparison.drawn_how, *comparison.notes()]
        self.notes = [line for note in notes for line in textwrap.wrap(note, LINE)]
        labels = [group.label for group in comparison.groups] if len(comparison.groups) > 1 else []
        self.labels = [_wrapped(label, int((WIDTH - 0.65) / LETTER)) for label in labels]
        widest = max((len(line) for label in self.labels for line in label.splitlines()), default=0)
        self.beside = max(1, min(BESIDE, int(WIDTH / (LETTER * widest + 0.65))))
        lines = [label.count("\n") + 1 for label in self.labels]
        self.rows = sum(lines) if self.beside == 1 else -(-len(lines) // self.beside)
        self.height = 0.42 + ROW * len(self.notes) + 0.215 * self.rows

    def write(self, figure: Figure, height: float) -> None:
        """Write it into a figure that is `height` inches high."""
        figure.text(0.02, 1 - 0.12 / height, literal(self.comparison.title), fontsize=11.5, fontweight="bold", va="top")
        notes = literal("\n".join(self.notes))
        figure.text(0.02, 1 - 0.38 / height, notes, fontsize=8, color=GREY, va="top", linespacing=1.35)
        if self.labels:
            figure.legend(
                handles=[_handle(k, label) for k, label in enumerate(self.labels)],
                loc="upper left",
                bbox_to_anchor=(0.012, 1 - (0.36 + ROW * len(self.notes)) / height),
                ncols=self.beside,
                frameon=False,
                handlelength=2.4,
                columnspacing=1.6,
                borderaxespad=0,
            )


def _wrapped(label: str, width: int) -> str:
    """The label in lines of at most `width` characters, which end at commas if it has some."""
    return label if len(label) <= width else textwrap.fill(re.sub(",(?! )", ", ", label), width)


def _handle(number: int, label: str) -> Line2D:
    ink, dash = look(number)
    return Line2D([], [], color=ink, linestyle=dash, linewidth=2.2, label=literal(label))
