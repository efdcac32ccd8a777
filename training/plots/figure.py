"""Figures: their style and files, panels with lines of runs, and the figure of a comparison. By matplotlib."""

import io
import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ..base.curves import Array, Curves, average
from ..base.quantities import RATING
from .comparison import Comparison, drawn, hours
from .runs import RunGroup

DPI = 150  # pixels an inch
GREY = "#5b5f68"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelcolor": GREY,
    "axes.edgecolor": "#9a9da4",
    "xtick.color": GREY,
    "ytick.color": GREY,
    "text.color": "#26292f",
    "svg.hashsalt": "outlast",  # the same picture gives the same file
}
WIDTH, PANEL = 7.6, 2.35  # inches: of the figure; height of a row of panels
COLUMNS, BESIDE = 2, 4  # maximum in a row: panels; entries of the legend
LINE = 125  # characters of a line of a note
STEPS = ((1e6, "million agent-steps"), (1e3, "thousand agent-steps"), (1.0, "agent-steps"))
HOURS = ((1.0, "hours of training"), (1 / 60, "minutes of training"), (1 / 3600, "seconds of training"))
ROW, LETTER = 0.2, 0.085  # inches: height of a line of text, width of a letter in the legend
# Colours of Okabe and Ito, which are distinct with any colour vision, also in grey; without their yellow.
INKS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
DASHES = ("-", (0, (3.5, 1.4)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)))


def encoded(draw: Callable[[], Figure], form: str, about: dict[str, str], colours: int = 256) -> bytes:
    """Return the figure of `draw` as the content of a file, "png" or "svg": the same figure gives the same bytes.

    about: Stored in the file: "Title", and "Source", a digest of the content. colours: Number of colours of a PNG, at
    most 256, which take a quarter of the bytes of true colour.
    """
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure = draw()
        if form == "svg":
            figure.savefig(content, format=form, metadata={**about, "Date": None})
            return content.getvalue()
        pixels, texts = io.BytesIO(), PngInfo()
        figure.savefig(pixels, format="png", dpi=DPI)
    for key, text in about.items():
        texts.add_text(key, text)
    few = Image.open(pixels).convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE)
    few.save(content, format="png", optimize=True, pnginfo=texts, dpi=(DPI, DPI))
    return content.getvalue()


def look(number: int) -> tuple[str, Any]:
    """Return the colour and dashes of a group; when colours repeat, dashes differ."""
    return INKS[number % len(INKS)], DASHES[number // len(INKS) % len(DASHES)]


def literal(text: str) -> str:
    """Escape a text, so that $ does not begin a formula."""
    return text.replace("$", r"\$")


class Line(NamedTuple):
    """A curve of some runs, with places on the axis for steps: their moving average, and points or a band behind it."""

    runs: Sequence[Curves]
    name: str
    ink: str
    dash: Any
    points: bool = True  # whether the points of a single run are shown
    common: bool = False  # see `average`


def plot_line(axes: Axes, line: Line) -> None:
    """Draw the moving average over runs; behind it the points of a single run, or the range of several."""
    found = average(line.runs, line.name, common=line.common)
    if not len(found.steps):  # one ends before another begins
        return
    looks: dict[str, Any] = {"color": line.ink, "linestyle": line.dash, "linewidth": 1.7, "zorder": 3}
    axes.plot(found.steps, found.mean, marker="o" if len(found.steps) == 1 else "", markersize=4, **looks)
    if len(line.runs) > 1:
        axes.fill_between(found.steps, found.low, found.high, color=line.ink, alpha=0.16, linewidth=0, zorder=1)
    elif line.points:
        (run,) = line.runs
        axes.plot(run.steps, run.values[line.name], color=line.ink, linewidth=0.5, alpha=0.3, zorder=1)


def write_notes(figure: Figure, title: str, notes: Sequence[str]) -> None:
    """Write a title and lines of notes at the top of a figure."""
    height = figure.get_figheight()
    figure.text(0.02, 1 - 0.12 / height, literal(title), fontsize=11.5, fontweight="bold", va="top")
    text = literal("\n".join(notes))
    figure.text(0.02, 1 - 0.38 / height, text, fontsize=8, color=GREY, va="top", linespacing=1.35)


def picture(comparison: Comparison, form: str) -> bytes:
    """Return the figure as the content of a file, "png" or "svg"; the same runs give the same bytes."""
    return encoded(lambda: draw(comparison), form, {"Title": comparison.title, "Source": comparison.digest()})


def draw(comparison: Comparison) -> Figure:
    """Draw a panel for each curve of a comparison, with a line for each group that has it."""
    longest, scale, unit = _axis(comparison)
    panels, common = list[tuple[str, list[Line]]](), comparison.x == "time"
    for panel in comparison.panels:
        lines = list[Line]()
        for k, group in enumerate(comparison.groups):
            own = [Curves(where / scale, each) for where, each in _curves(comparison, group) if panel.name in each]
            if own:
                lines.append(Line(own, panel.name, *look(k), points=comparison.faint, common=common))
        panels.append((panel.title, lines))
    legend = [(group.label, *look(k)) for k, group in enumerate(comparison.groups)]
    notes = [comparison.drawn_how, *comparison.notes()]
    return panels_of(comparison.title, notes, legend if len(legend) > 1 else [], panels, longest / scale, unit)


def _curves(comparison: Comparison, group: RunGroup) -> Iterator[tuple[Array, dict[str, Array]]]:
    """Return the points of each run on the axis, agent-steps or hours, and its curves there."""
    for run in group.runs:
        where = run.curves.steps if comparison.x == "steps" else hours(run)
        if where is not None:
            yield where, drawn(run, comparison.panels).values


def _axis(comparison: Comparison) -> tuple[float, float, str]:
    """Return the end of the axis, the divisor that makes its numbers short, and its label."""
    if comparison.x == "steps":
        longest, units = float(max(run.steps for run in comparison.runs)), STEPS
    else:
        longest = max(min(float(where[-1]) for where, _ in _curves(comparison, each)) for each in comparison.groups)
        units = HOURS
    return longest, *next((pair for pair in units if longest >= pair[0]), units[-1])


def panels_of(
    title: str,
    notes: Sequence[str],
    legend: Sequence[tuple[str, str, Any]],
    panels: Sequence[tuple[str, Sequence[Line]]],
    end: float,
    unit: str,
) -> Figure:
    """Draw panels in pairs, each with its title and lines, under a title, notes and a legend: labels, colours, dashes.

    end, unit: The end of all horizontal axes, which begin at 0, and their label.
    """
    notes = [line for note in notes for line in textwrap.wrap(note, LINE)]
    labels = [_wrapped(label, int((WIDTH - 0.65) / LETTER)) for label, _, _ in legend]
    widest = max((len(line) for label in labels for line in label.splitlines()), default=0)
    beside = max(1, min(BESIDE, int(WIDTH / (LETTER * widest + 0.65))))
    below = sum(label.count("\n") + 1 for label in labels) if beside == 1 else -(-len(labels) // beside)
    head, columns = 0.42 + ROW * len(notes) + 0.215 * below, min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    height = head + rows * PANEL + 0.3
    figure = Figure((WIDTH, height))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    top, bottom = 1 - (head + 0.25) / height, 0.5 / height
    figure.subplots_adjust(left=0.085, right=0.972, bottom=bottom, top=top, hspace=0.34, wspace=0.2)
    for axes, (name, lines) in zip(grid, panels, strict=False):
        axes.set_title(literal(name))
        axes.set_xlim(0, end)
        for line in lines:
            plot_line(axes, line)
        values = [np.asarray(line.get_ydata(), float) for line in axes.lines]
        rated = any(line.name.startswith(RATING) for line in lines)  # where only differences matter
        if values and not rated and min(map(np.nanmin, values)) >= 0:
            axes.set_ylim(0, max(axes.get_ylim()[1], 1.05 * max(map(np.nanmax, values))) or 1)
        axes.grid(alpha=0.25, linewidth=0.6)
        axes.tick_params(length=0)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes in grid[max(0, len(panels) - columns) : len(panels)]:
        axes.set_xlabel(unit)
    write_notes(figure, title, notes)
    if legend:
        figure.legend(
            handles=[Line2D([], [], color=ink, linestyle=dash, linewidth=2.2) for _, ink, dash in legend],
            labels=list(map(literal, labels)),
            loc="upper left",
            bbox_to_anchor=(0.012, 1 - (0.36 + ROW * len(notes)) / height),
            ncols=beside,
            frameon=False,
            handlelength=2.4,
            columnspacing=1.6,
            borderaxespad=0,
        )
    return figure


def _wrapped(label: str, width: int) -> str:
    """Return the label in lines of at most `width` characters, which end at commas if possible."""
    return label if len(label) <= width else textwrap.fill(re.sub(",(?! )", ", ", label), width)
