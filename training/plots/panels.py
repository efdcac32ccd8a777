"""Curves to choose from: the logged tags of a run, under the names of the option --curves."""

import re
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from outlast.ecs.kernels.errors import did_you_mean

from ..base.curves import Array, Curves
from ..base.errors import TrainingError
from ..base.metrics import PAPER_NAMES
from ..base.quantities import SUMMED, combinable
from .runs import Run

ROLLOUT = "rollout/"
FIRST = ("return", "length", "kills", "heals_used")
LAST = ("wins/",)  # prefixes of the names of curves that come after the statistics
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


def chosen(runs: Sequence[Run], names: Sequence[str]) -> list[Panel]:
    """Return the panels of these names or, without names, the usual ones.

    names: "length", "return" and other statistics of episodes; or tags of a log, "wins/scripted", "rollout/kills0",
    "train/entropy". Raises TrainingError: no run has one of these curves.
    """
    logs = [run.curves.values for run in runs]
    tags = list(dict.fromkeys(tag for log in logs for tag in log))
    known = _known(tags, logs)
    if not names:
        return [known[name] for name in usual(known)]
    panels = []
    for name in names:
        if name not in known and name not in tags:
            hint = did_you_mean(name, [*known, *tags], after=" ")
            raise TrainingError(f"these runs have no curve '{name}'; {hint}they have: {', '.join(known)}")
        panels.append(known.get(name) or Panel(name, (name,)))
    return panels


def usual(known: Collection[str]) -> list[str]:
    """Return the names of the curves that are drawn by default."""
    first = [name for name in FIRST if name in known]
    statistics = (name for name in known if "/" not in name and not name.startswith("deaths_"))
    rest = [name for name in statistics if name not in (*FIRST, *RARE)]
    return [*first, *rest, *(name for name in known if name.startswith(LAST))][:MOST]


def _known(tags: Sequence[str], logs: Sequence[Collection[str]]) -> dict[str, Panel]:
    found: dict[str, list[str]] = {}
    for tag in sorted(tags):
        found.setdefault(name_of(tag, tags), []).append(tag)
    returns = found.get("return", [])
    return {name: Panel(name, tuple(own), _owners(own, returns, logs)) for name, own in found.items()}


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
    values = {panel.name: _combined(run.curves, panel) for panel in panels}
    return Curves(run.curves.steps, {name: own for name, own in values.items() if own is not None})


def _combined(curves: Curves, panel: Panel) -> Array | None:
    own = [curves.values[tag] for tag in combinable([tag for tag in panel.tags if tag in curves.values])]
    if not any(np.isfinite(each).any() for each in own):
        return None
    if panel.name in SUMMED:
        combined: Array = np.sum(own, 0)
    else:
        with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a rollout may lack all sides
            combined = np.nanmean(own, 0)  # over the sides present
    return combined


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
