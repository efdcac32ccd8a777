"""Runs drawn and written: `outlast plot`, and outlast.plot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from outlast.envs.api.options import option
from outlast.envs.errors import needed

from ..base.errors import TrainingError
from ..base.files import write_files
from ..base.quantities import ENDS
from .comparison import AXES, Comparison, chosen, hours
from .runs import group_runs, load

FORMS = ("png", "svg")
FIGURE = "curves"  # name of the figure's file
DRAWN, OUTPUT = "what is drawn", "output"  # groups of options


def compare(places: Sequence[Path], by: Sequence[str] = (), curves: Sequence[str] = (), x: str = "steps") -> Comparison:
    """Compare the runs in these places, without writing anything; see `plot`."""
    if not places:
        raise TrainingError("runs are missing: name their folders, or a folder that contains them")
    runs = load(places)
    if x not in AXES:
        raise TrainingError(f"x = {x!r}: allowed are {', '.join(AXES)}")
    if x == "time" and (without := [run for run in runs if hours(run) is None]):
        raise TrainingError(f"{without[0].origin} has no record of its duration: leave out --x time")
    return Comparison(tuple(group_runs(runs, by)), tuple(chosen(runs, curves)), x)


def plot(
    runs: str | Path | Sequence[str | Path],
    out: str | Path = "figures",
    *,
    by: str | Sequence[str] = (),
    curves: str | Sequence[str] = (),
    x: str = "steps",
    form: str = "png",
) -> Comparison:
    """Draw the curves of runs in one figure, and write a table of their end values; `outlast plot` does the same.

    >>> print(outlast.plot(["runs/weak", "runs/strong"], by="melee_damage"))

    Args:
        runs: Folders of runs, folders that contain several of them, or of kept results: all, or one by its name,
            as "results/original/ffa_4-original-0".
        out: Folder for figures and tables: curves.png, ends.md, ends.csv.
        by: Settings of the game, of PPO or of the run that distinguish groups, such as melee_damage,opponents (default:
            all but the seed). In Python one name, or a list of names.
        curves: What to draw: statistics of episodes, such as return,length, or tags of log.csv, such as wins/scripted
            (default: up to six). In Python one name, or a list of names.
        x: Horizontal axis: agent-steps, or hours of training. One of steps and time.
        form: Format of the figures. One of png and svg.

    Returns:
        The comparison. `str` turns it into the table in Markdown; `files` has the paths of the files written.

    Raises:
        TrainingError: No runs are found, a setting or curve is unknown, or matplotlib is missing; nothing is written.
    """
    with needed("plot", "figures need {}", TrainingError):
        from .figure import picture
    if form not in FORMS:
        raise TrainingError(f"form = {form!r}: allowed are {', '.join(FORMS)}")
    places = [runs] if isinstance(runs, (str, Path)) else runs
    by, curves = ([given] if isinstance(given, str) else given for given in (by, curves))
    found, folder = compare([Path(place) for place in places], by, curves, x), Path(out)
    contents = {
        folder / f"{FIGURE}.{form}": picture(found, form),
        folder / "ends.md": str(found).encode(),
        folder / ENDS: found.csv().encode(),
    }
    write_files(contents)
    found.files.extend(contents)
    return found


@dataclass(frozen=True)
class PlotOptions:
    """The options of `outlast.plot` that are flags."""

    described = plot
    out: str | Path = option("figures", OUTPUT)
    by: str | Sequence[str] = option((), DRAWN, metavar="NAME,...")
    curves: str | Sequence[str] = option((), DRAWN, metavar="NAME,...")
    x: str = option("steps", DRAWN, choices=AXES)
    form: str = option("png", OUTPUT, flag="--format", choices=FORMS)
