"""The paper's figures: curves of a group of runs over the paper's own. Needs matplotlib."""

import hashlib
import json
from typing import Any

from matplotlib.figure import Figure

from ..base.curves import BOXES, HEALS, KILLS, LENGTH, RETURN, Curves, window_size
from ..plots.figure import GREY, INKS, Line, encoded, panels_of
from .results import PaperGroup

COLOURS = 128  # colours of a PNG
DASHES = ("-", (0, (2.2, 1.4)), ":", "-.")  # for the sides
MILLION = 1e6
OURS, THEIRS = INKS[:2]


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
    """Draw the paper's quantities in four panels, the paper's curves behind ours; without boxes, the length instead."""
    ours, count = [run.curves for run in group.runs], len(group.runs)
    boxes = any(curves.tags(BOXES) for curves in ours)
    panels, sides = list[tuple[str, list[Line]]](), 0
    for quantity in (RETURN, HEALS, KILLS, BOXES) if boxes else (RETURN, LENGTH, HEALS, KILLS):
        lines = list[Line]()
        for runs, ink in (([group.paper], THEIRS), (ours, OURS)):
            tags = dict.fromkeys(tag for curves in runs for tag in curves.tags(quantity))
            scaled = [Curves(curves.steps / MILLION, curves.values) for curves in runs]
            lines += [Line(scaled, tag, ink, DASHES[side % len(DASHES)]) for side, tag in enumerate(tags)]
            sides = max(sides, len(tags))
        panels.append((quantity.name + (f", each {group.side}" if quantity.sided else ""), lines))
    several = "band: from the lowest to the highest seed; faint: the paper's points"
    points = window_size(max(len(curves.steps) for curves in ours))
    how = f"Lines: moving averages over 5 % of the points (of ours {points}); "
    title = f"{group.variant}, preset {group.preset}, {'one seed' if count == 1 else f'{count} seeds'}"
    legend: list[tuple[str, str, Any]] = [("outlast", OURS, "-"), ("the paper", THEIRS, "-")]
    legend += [(f"{group.side} {k}", GREY, DASHES[k % len(DASHES)]) for k in range(sides)]
    end = max(curves.steps[-1] for curves in (group.paper, *ours)) / MILLION
    notes = [how + ("faint: all points" if count == 1 else several), *group.notes()]
    return panels_of(title, notes, legend, panels, end, "million agent-steps")
