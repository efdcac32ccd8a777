"""The paper's figures: curves of a group of runs over the paper's own. Needs matplotlib."""

import hashlib
import json
import textwrap
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from outlast.envs.rendering import style

from ..base.curves import BOXES, HEALS, KILLS, LENGTH, RETURN, Curves, Quantity, window_size
from ..plots.figure import GREY, Line, colour, encoded, entry, figure_of, finish, plot_line, write_notes
from .results import PaperGroup

SIZE = (7.6, 5.7)  # inches
COLOURS = 128  # colours of a PNG
LINE = 105  # characters of a line of a note
DASHES = ("-", (0, (2.2, 1.4)), ":", "-.")  # for the sides
MILLION = 1e6
OURS, THEIRS = colour(style.BLUE), colour(style.VERMILLION)


def picture(group: PaperGroup, form: str) -> bytes:
    """Return the figure of a group as a file: "png" or "svg". Its Source is the digest of its content."""
    return encoded(lambda: draw(group), form, {"Title": group.name, "Source": digest(group)}, COLOURS)


def digest(group: PaperGroup) -> str:
    """Return a digest of the content of a figure: all curves, and the settings that differ from the paper's."""
    total = hashlib.blake2b(digest_size=16)
    for run in group.runs:
        total.update(json.dumps([group.name, run.unlike, run.seed], sort_keys=True).encode())
    for curves in [*(run.curves for run in group.runs), group.paper]:
        total.update(curves.steps.tobytes())
        for tag, values in sorted(curves.values.items()):
            total.update(tag.encode() + values.tobytes())
    return total.hexdigest()


def draw(group: PaperGroup) -> Figure:
    """Draw the paper's quantities in four panels under a heading; without boxes, the length instead."""
    figure = figure_of(*SIZE)
    notes = [line for note in group.notes() for line in textwrap.wrap(note, LINE)]
    top = 1 - (0.82 + 0.17 * len(notes)) / SIZE[1]
    panels = figure.subplots(2, 2, sharex=True)
    figure.subplots_adjust(left=0.085, right=0.985, bottom=0.085, top=top, hspace=0.2, wspace=0.17)
    boxes = any(run.curves.tags(BOXES) for run in group.runs)
    quantities = (RETURN, HEALS, KILLS, BOXES) if boxes else (RETURN, LENGTH, HEALS, KILLS)
    for axes, quantity in zip(panels.flat, quantities, strict=True):
        _panel(axes, group, quantity)
    for axes in panels[-1]:
        axes.set_xlabel("million agent-steps")
    _heading(figure, group, notes)
    return figure


def _panel(axes: Axes, group: PaperGroup, quantity: Quantity) -> None:
    """Draw one quantity: the paper's behind ours."""
    axes.set_title(quantity.name + (f", each {group.side}" if quantity.sided else ""))
    for runs, ink, front in (([group.paper], THEIRS, 2), ([run.curves for run in group.runs], OURS, 3)):
        scaled = [Curves(curves.steps / MILLION, curves.values) for curves in runs]
        for side, tag in enumerate(_tags(runs, quantity)):
            plot_line(axes, Line(scaled, tag, ink, DASHES[side % len(DASHES)], front=front, width=1.6))
    axes.set_xlim(0, max(curves.steps[-1] for curves in _all(group)) / MILLION)
    finish(axes)


def _heading(figure: Figure, group: PaperGroup, notes: Sequence[str]) -> None:
    """Write the title, the smoothing of curves, the notes of the group, and the legend."""
    count = len(group.runs)
    points = window_size(max(len(run.curves.steps) for run in group.runs))
    several = "band: from the lowest to the highest seed; faint: the paper's points"
    behind = "faint: all points" if count == 1 else several
    how = f"Lines: moving averages over 5 % of the points (of ours {points}); {behind}"
    title = f"{group.variant}, preset {group.preset}, {'one seed' if count == 1 else f'{count} seeds'}"
    write_notes(figure, title, [how, *notes])
    sides = [entry(f"{group.side} {k}", GREY, DASHES[k % 4]) for k in range(len(_tags(_all(group), RETURN)))]
    figure.legend(
        handles=[entry("outlast", OURS), entry("the paper", THEIRS), *sides],
        loc="upper right",
        bbox_to_anchor=(0.99, 1 - 0.05 / SIZE[1]),
        ncols=4,
        frameon=False,
        handlelength=2,
        columnspacing=1.2,
    )


def _all(group: PaperGroup) -> list[Curves]:
    return [group.paper, *(run.curves for run in group.runs)]


def _tags(runs: Sequence[Curves], quantity: Quantity) -> list[str]:
    """Return the tags of a quantity that any of the curves has."""
    return list(dict.fromkeys(tag for curves in runs for tag in curves.tags(quantity)))
