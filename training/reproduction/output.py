"""What `outlast paper` writes of a part when its runs are there: kept results, figures, tables, claims, films."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import outlast
from outlast.envs.scenarios.scenario import Scenario

from .. import checkpoint
from ..files import write_files
from ..paper.report import figures_and_tables
from ..paper.results import files_to_keep, group_runs, load_runs, policy_only
from ..plots.plot import plot
from . import mended
from .experiments import PARTS, SECONDS, Experiment, experiments, seconds_table

FILM: dict[str, Any] = {"size": 256, "every": 6, "fps": 15, "views": "+vision"}
CURVES = ("length", "kills", "wins/scripted", "damage_dealt", "strikes_landed", "heals_given")  # of mended games
FIRST = "original"  # the part that others are compared with
Progress = Callable[[int], object]


def write_part(part: str, chosen: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Write everything of a part; the path of each file when it is there.

    Args:
        part: One of experiments.PARTS.
        chosen: The experiments of it that are wanted; others whose runs are in the folder are there, too.
        out: Of the command.
        progress: Called with 1 after each thing that took long.

    Raises:
        TrainingError: Runs are not there, or something cannot be written.
    """
    yield from _written(
        {out / SECONDS: seconds_table((each, _folders(each, out)) for each in experiments(PARTS)).encode()}
    )
    yield from (_mended if part == "mended" else _beside_the_paper)(part, chosen, out, progress)


def _beside_the_paper(part: str, chosen: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Results to keep, figures, tables, and a film of each variant."""
    runs = load_runs(folder for each in chosen for folder in _folders(each, out))
    yield from _written(files_to_keep(runs, out / part))
    kept = [out / FIRST / path.name for path in sorted((out / FIRST).glob("*.csv")) if part != FIRST]
    beside = [run for run in load_runs(kept) if run.variant in {each.game for each in chosen}]
    files = figures_and_tables(group_runs(runs), "png", group_runs(beside))
    yield from _written({out / part / name: content for name, content in files.items()})
    progress(1)
    for each in chosen:
        yield _film(each.scenario, _folders(each, out)[0], out / part / f"{each.game}-{each.preset}.gif")
        progress(1)


def _mended(part: str, chosen: Sequence[Experiment], out: Path, progress: Progress) -> Iterator[Path]:
    """Policies to keep, what was measured of them, a figure for each variant, and a film of each game."""
    measured: dict[str, list[Path]] = {}
    for each in chosen:
        for folder in _folders(each, out):
            place = out / part / "measured" / folder.name
            mended.measure(each.scenario, folder, place)
            measured.setdefault(each.name, []).append(place)
            yield from _written({out / part / f"{folder.name}.zip": policy_only(checkpoint.newest(folder))})
            progress(1)
    yield from _written({out / part / "measured.md": (mended.table(measured) + "\n").encode()})
    for name in dict.fromkeys(each.game.partition("+")[0] for each in chosen):
        changed = sorted(
            {pair.partition("=")[0] for each in chosen if each.game.partition("+")[0] == name for pair in each.numbers}
        )
        own = [folder for each in chosen if each.game.partition("+")[0] == name for folder in _folders(each, out)]
        yield from plot(own, out / part / name, by=("scenario", *changed), curves=CURVES).files
        progress(1)
    for each in chosen:
        yield _film(each.scenario, _folders(each, out)[0], out / part / f"{each.name}.gif")
        progress(1)


def _written(contents: dict[Path, bytes]) -> list[Path]:
    write_files(contents)
    return list(contents)


def _film(game: Scenario, run: Path, path: Path) -> Path:
    """An episode of a run's last policy."""
    policy = checkpoint.newest(run)
    first = outlast.rollout(game, policy, worlds=1, seed=0)
    length = int(next(mean for name, mean, _ in first.rows() if name == "length"))
    return outlast.film(game, path, policy=policy, worlds=1, seed=0, steps=length, **FILM)


def _folders(experiment: Experiment, out: Path) -> list[Path]:
    """Of the runs of an experiment, in order of seeds."""
    place = experiment.folder(out, 0).parent
    found = [path for path in place.glob(f"{experiment.name}-{experiment.preset}-*") if checkpoint.checkpoints(path)]
    return sorted(found, key=lambda path: int(path.name.rpartition("-")[2]))
