"""Output of `reproduce` about a part whose runs exist: kept results, figures, tables, claims, films."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import outlast
from outlast.envs.rendering.video.codecs import compress
from outlast.envs.rollout.saved import newest
from outlast.envs.scenarios.scenario import Scenario

from ..base import policy_file
from ..base.curves import FILE, format_curves, rounded, thinned
from ..base.errors import TrainingError
from ..base.files import write_files
from ..plots.plot import plot
from ..plots.runs import kept_runs
from ..policies.player import weights_of
from . import corrected_games as mended
from .compare import figures_and_tables
from .experiments import PARTS, SECONDS, Experiment, experiments, seconds_table
from .results import curves_to_keep, group_runs, load_runs

FILM: dict[str, Any] = {"size": 256, "every": 6, "fps": 15, "views": "+vision"}
CURVES = ("length", "kills", "wins/scripted", "damage_dealt", "strikes_landed", "heals_given")  # of corrected games
POINTS, DIGITS = 64, 3  # of kept curves of corrected games, which are only drawn, as averages
FIRST = "original"  # the part that others are compared with
Progress = Callable[[int], object]


def write_part(part: str, chosen: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Write all output of a part, and yield the path of each file once it is written.

    Figures and tables show all experiments of the part whose runs are in the folder; otherwise one game's would replace
    those of another. Corrected games that are not chosen are shown if they were measured before.

    chosen: The experiments to film. out: The output folder of the command. progress: Called with 1 after each long
    task. Raises TrainingError: runs are missing, or a file cannot be written.
    """
    before = (out / SECONDS).read_text(encoding="utf-8") if (out / SECONDS).exists() else ""
    timed = seconds_table(experiments(PARTS), out, before)
    yield from _written({out / SECONDS: timed.encode()})
    there = [each for each in experiments([part]) if each.results(out)]
    if part == "mended":
        known = mended.read_measured(out / part / mended.FILE)
        shown = [each for each in there if each in chosen or all(_measured(run, known) for run in each.results(out))]
        yield from _mended(part, shown, out, progress)
    else:
        yield from _beside_the_paper(part, there, out, progress)
    for each in chosen:
        yield _film(each.scenario, each.policy(out, each.results(out)[0]), out / part / each.film)
        progress(1)


def _beside_the_paper(part: str, there: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Yield kept results, figures and tables."""
    runs = load_runs(place for each in there for place in each.results(out))
    yield from _written(curves_to_keep(runs, out / part) | _policies(there, out))
    games = {each.game for each in there}
    others = [each for each in experiments([FIRST]) if part != FIRST and each.game in games]
    beside = load_runs(place for each in others for place in each.results(out))
    files = figures_and_tables(group_runs(runs), "png", group_runs(beside))
    yield from _written({out / part / name: content for name, content in files.items()})
    progress(1)


def _mended(part: str, there: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Yield kept policies, curves and measurements; a table, and a figure for each variant."""
    study = out / part
    curves, measured = kept_runs(study), mended.read_measured(study / mended.FILE)
    for each in there:
        for run in each.results(out):
            if run.is_dir():
                mended.measure(each.scenario, run)
                measured[run.name] = mended.rows(run)
                (result,) = load_runs([run])
                curves[run.name] = result.about, rounded(thinned(result.curves, POINTS), DIGITS)
            elif run.name not in measured:
                raise TrainingError(f"{study / mended.FILE} does not have {run.name}, and its folder is missing")
            progress(1)
    kept = {FILE: format_curves(dict(sorted(curves.items())))}
    kept |= {mended.FILE: mended.format_measured(dict(sorted(measured.items())))}
    shown = {each.name: [measured[run.name] for run in each.results(out)] for each in there}
    kept |= {"measured.md": (mended.table(shown) + "\n").encode()}
    yield from _written({study / name: content for name, content in kept.items()} | _policies(there, out))
    changed = sorted({pair.partition("=")[0] for each in there for pair in each.numbers})
    runs = dict[str, list[Path]]()
    for each in there:
        runs.setdefault(each.game.partition("+")[0], []).extend(study / run.name for run in each.results(out))
    for name, own in runs.items():
        yield from plot(own, study / name, by=("scenario", *changed), curves=CURVES).files
        progress(1)


def _measured(run: Path, known: mended.Measured) -> bool:
    """Return whether a run was measured, by its folder or by kept results."""
    return mended.is_measured(run) if run.is_dir() else run.name in known


def _written(contents: dict[Path, bytes]) -> list[Path]:
    write_files(contents)
    return list(contents)


def _policies(there: Sequence[Experiment], out: Path) -> dict[Path, bytes]:
    """Return the policies to keep of the runs whose folders exist, by path."""
    runs = ((each, run) for each in there for run in each.results(out) if run.is_dir())
    return {each.kept_policy(out, run): policy_file.content(*weights_of(newest(run))) for each, run in runs}


def _film(game: Scenario, policy: Path, path: Path) -> Path:
    """Film an episode of a policy."""
    first = outlast.rollout(game, policy, worlds=1, seed=0)
    length = int(next(mean for name, mean, _ in first.rows() if name == "length"))
    with tempfile.TemporaryDirectory() as folder:
        film, small = Path(folder, "film.mp4"), Path(folder, path.name)
        compress(outlast.film(game, film, policy=policy, worlds=1, seed=0, steps=length, **FILM), small)
        (written,) = _written({path: small.read_bytes()})
    return written
