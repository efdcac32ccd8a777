"""The paper's figures: curves of a group of runs over the paper's own. Needs matplotlib."""

import hashlib
import json
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from outlast.envs.rendering import style

from ..base.averages import average, window_size
from ..base.curves import BOXES, HEALS, KILLS, LENGTH, RETURN, Curves, Quantity
from ..base.image import GREY, colour, encoded, literal
from .end_values import side_name
from .results import PaperGroup

WIDTH, HEIGHT = 7.6, 5.7  # inches
COLOURS = 128  # colours of a PNG
LINE = 105  # characters of a line of a note
DASHES: tuple[Any, ...] = ("-", (0, (2.2, 1.4)), ":", "-.")  # for the sides

OURS, THEIRS = colour(style.BLUE), colour(style.VERMILLION)


def picture(group: PaperGroup, form: str) -> bytes:
    """The figure of a group as a file: "png" or "svg". It holds the digest of what it shows, as Source."""
    return encoded(lambda: draw(group), form, {"Title": group.name, "Source": digest(group)}, COLOURS)


def digest(group: PaperGroup) -> str:
    """A digest of what a figure shows: all curves, and the settings that are not the paper's."""
    total = hashlib.blake2b(digest_size=16)
    for run in group.runs:
        total.update(json.dumps([group.name, run.unlike, run.seed], sort_keys=True).encode())
    for curves in [*(run.curves for run in group.runs), group.paper]:
        total.update(curves.steps.tobytes())
        for tag, values in sorted(curves.values.items()):
            total.update(tag.encode() + values.tobytes())
    return total.hexdigest()


def draw(group: PaperGroup) -> Figure:
    """Four panels under a heading."""
    figure = Figure(figsize=(WIDTH, HEIGHT))
    FigureCanvasAgg(figure)
    notes = [line for note in group.notes() for line in textwrap.wrap(note, LINE)]
    top = 1 - (0.82 + 0.17 * len(notes)) / HEIGHT
    panels = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.085, right=0.985, bottom=0.085, top=top, hspace=0.2, wspace=0.17)
    for axes, quantity in zip(panels.flat, panel_quantities(group), strict=True):
        panel(axes, group, quantity)
    for axes in panels[-1]:
        axes.set_xlabel("million agent-steps")
    _heading(figure, group, notes)
    return figure


def panel_quantities(group: PaperGroup) -> tuple[Quantity, ...]:
    """The paper's four quantities; where there are no boxes, the length of episodes instead of them."""
    boxes = any(run.curves.tags(BOXES) for run in group.runs)
    return (RETURN, HEALS, KILLS, BOXES) if boxes else (RETURN, LENGTH, HEALS, KILLS)


def panel(axes: Axes, group: PaperGroup, quantity: Quantity) -> None:
    """Draw one quantity: the paper's behind ours."""
    axes.set_title(quantity.name + (f", each {side_name(group)}" if quantity.sided else ""))
    for runs, ink, order in (([group.paper], THEIRS, 2), ([run.curves for run in group.runs], OURS, 3)):
        for side, tag in enumerate(_tags(runs, quantity)):
            _curve(axes, runs, tag, ink, order, DASHES[side % len(DASHES)])
    axes.set_xlim(0, _millions(max(curves.steps[-1] for curves in _all(group))))
    axes.set_ylim(bottom=min(0, axes.get_ylim()[0]) if _negative(group, quantity) else 0)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.tick_params(length=0)


def _curve(axes: Axes, runs: Sequence[Curves], tag: str, ink: str, order: int, dash: Any) -> None:
    """The moving average over runs; behind it points of a single run, or the range of several."""
    line = average(runs, tag)
    axes.plot(_millions(line.steps), line.mean, color=ink, linewidth=1.6, linestyle=dash, zorder=order)
    if len(runs) == 1:
        (one,) = runs
        axes.plot(_millions(one.steps), one.values[tag], color=ink, linewidth=0.5, alpha=0.22, zorder=1)
    else:
        axes.fill_between(_millions(line.steps), line.low, line.high, color=ink, alpha=0.18, linewidth=0, zorder=1)


def _heading(figure: Figure, group: PaperGroup, notes: Sequence[str]) -> None:
    """The title, how curves are smoothed, the notes of the group, and the legend."""
    count = len(group.runs)
    title = f"{group.variant}, preset {group.preset}, {'one seed' if count == 1 else f'{count} seeds'}"
    figure.text(0.02, 1 - 0.12 / HEIGHT, title, fontsize=11.5, fontweight="bold", va="top")
    points = window_size(max(len(run.curves.steps) for run in group.runs))
    several = "band: from the lowest to the highest seed; faint: the paper's points"
    behind = "faint: all points" if count == 1 else several
    lines = [f"Lines: moving averages over 5 % of the points (of ours {points}); {behind}", *notes]
    figure.text(0.02, 1 - 0.36 / HEIGHT, literal("\n".join(lines)), fontsize=8, color=GREY, va="top", linespacing=1.35)
    figure.legend(
        handles=list(_handles(group)),
        loc="upper right",
        bbox_to_anchor=(0.99, 1 - 0.05 / HEIGHT),
        ncols=4,
        frameon=False,
        handlelength=2,
        columnspacing=1.2,
    )


def _handles(group: PaperGroup) -> Iterator[Line2D]:
    """Entries of the legend: colours for ours and the paper's, dashes for sides."""
    yield Line2D([], [], color=OURS, linewidth=2.4, label="outlast")
    yield Line2D([], [], color=THEIRS, linewidth=2.4, label="the paper")
    for side, _ in enumerate(_tags(_all(group), RETURN)):
        label = f"{side_name(group)} {side}"
        yield Line2D([], [], color=GREY, linewidth=1.4, linestyle=DASHES[side % len(DASHES)], label=label)


def _all(group: PaperGroup) -> list[Curves]:
    return [group.paper, *(run.curves for run in group.runs)]


def _tags(runs: Sequence[Curves], quantity: Quantity) -> list[str]:
    """The tags of a quantity that any of the curves has."""
    return list(dict.fromkeys(tag for curves in runs for tag in curves.tags(quantity)))


def _negative(group: PaperGroup, quantity: Quantity) -> bool:
    return any(np.nanmin(one.values[tag]) < 0 for one in _all(group) for tag in one.tags(quantity))


def _millions(steps: Any) -> Any:
    return steps / 1e6
