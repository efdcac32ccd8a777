"""reproduce: the paper's experiments and further ones, trained, measured and drawn in one command."""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import outlast
from outlast.ecs.kernels.available import available_cores
from outlast.envs.cli.options import STOPPED, add_quiet, nonnegative, output, positive
from outlast.envs.core.options import MACHINE, OUTPUT
from outlast.envs.errors import FilmError, install
from outlast.envs.progress import Progress, above_bars
from outlast.envs.rendering.films import compress, find_ffmpeg
from outlast.envs.rollout.saved import newest
from outlast.envs.scenarios.scenario import Scenario

from ..base import policy_file
from ..base.curves import FILE, format_curves, rounded, thinned
from ..base.errors import TrainingError
from ..base.files import check_out, write_files
from ..base.quantities import LiveView
from ..plots.plot import plot
from ..plots.runs import kept_runs
from ..policies.player import weights_of
from ..runs.child_runs import ChildRun, side_by_side
from . import corrected_games as mended
from .compare import figures_and_tables
from .experiments import PARTS, Experiment, experiments
from .results import curves_to_keep, group_runs, load_runs

Plan = list[tuple[Experiment, int]]  # with a seed
Counter = Callable[[int], object]  # of tasks that are done
FILM: dict[str, Any] = {"size": 256, "every": 6, "fps": 15, "views": "+vision"}
CURVES = ("length", "kills", "wins/scripted", "damage_dealt", "strikes_landed", "heals_given")  # of corrected games
POINTS, DIGITS = 64, 3  # of kept curves of corrected games, which are only drawn, as averages
FIRST = "original"  # the part that others are compared with


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "train, measure and draw the paper's experiments and more"
    examples = [
        ("reproduce --plan", "the runs to train, with their agent-steps"),
        ("reproduce original --out reproduction", "the eight experiments; the same command continues after Ctrl-C"),
        ("reproduce original --only ffa_2 teams_2 --seeds 1", "two of them, one seed each"),
    ]
    description = (
        "Train the runs of docs/paper.md, and write its figures, tables and films. The same command continues after it "
        "was stopped."
    )
    parts = "\n".join(f"  {name:10}{about}" for name, about in PARTS.items())
    command = commands.add_parser(
        "reproduce", help=text, description=description, examples=examples, epilog=f"parts:\n{parts}", run=run
    )
    done = command.group("what is done")
    text = f"parts to train: {', '.join(PARTS)}, see below (default: all)"
    done.add_argument("parts", nargs="*", metavar="PART", help=text)
    text = "only these games of the parts, such as ffa_2 (default: all)"
    done.add_argument("--only", nargs="+", default=[], metavar="GAME", help=text)
    text = "runs of each experiment, with one seed after the other (default: 3, of corrected games 2)"
    done.add_argument("--seeds", type=positive, metavar="N", help=text)
    text = "seed of the first run of each experiment (default 0)"
    done.add_argument("--first", type=nonnegative, default=0, metavar="SEED", help=text)
    text = "folder for runs, figures, tables and films (default paper)"
    command.group(OUTPUT).add_argument("--out", type=output(check_out), default="paper", help=text)
    text = "only print the runs to train, with the agent-steps that are left"
    done.add_argument("--plan", action="store_true", help=text)
    add_quiet(command)
    text = "runs that train at the same time (default: cores)"
    command.group(MACHINE).add_argument("--jobs", type=positive, help=text)


def run(options: argparse.Namespace) -> int:
    """Run the command. Return the exit status."""
    options.out = Path(options.out)
    chosen = _chosen(options)
    plan = _plan(chosen, options)
    jobs = options.jobs or available_cores()
    done = [min(each.steps, each.steps_done(options.out, seed)) for each, seed in plan]
    about, lines = _summary(plan, done, jobs)
    if options.plan:
        print("\n".join([about, *lines]))
        return 0
    try:  # ahead of hours of training
        find_ffmpeg(".webm")
    except FilmError as error:
        raise TrainingError(f"the films need FFmpeg: {install('train,plot,view')}") from error
    status = _train(plan, done, options, about, jobs)
    if status == STOPPED:
        return status
    for part in PARTS:  # also after a failed run, for the runs that did not fail
        if own := [each for each in chosen if each.part == part and each.results(options.out)]:
            about = f"figures and tables of {part}"
            with Progress(0, "steps", quiet=options.quiet, about=about) as progress:
                for made in write_part(part, own, options.out, progress.add):
                    with above_bars(sys.stdout):
                        print(made)
    return status


def _chosen(options: argparse.Namespace) -> list[Experiment]:
    """Return the requested experiments. Raises TrainingError."""
    for part in options.parts:
        if part not in PARTS:
            raise TrainingError(f"unknown part '{part}'; known: {', '.join(PARTS)}")
    chosen = experiments(options.parts or PARTS)
    games = list(dict.fromkeys(each.name for each in chosen))
    if unknown := [game for game in options.only if game not in games]:
        raise TrainingError(f"--only {unknown[0]}: unknown game; known: {', '.join(games)}")
    return [each for each in chosen if each.name in (options.only or games)]


def _plan(chosen: Sequence[Experiment], options: argparse.Namespace) -> Plan:
    """Return all runs, the first seed of every experiment ahead of the second."""
    counts = [options.seeds or each.seeds for each in chosen]
    rounds = range(options.first, options.first + max(counts))
    return [(each, seed) for seed in rounds for each, count in zip(chosen, counts) if seed - options.first < count]


def _summary(plan: Plan, done: Sequence[int], jobs: int) -> tuple[str, list[str]]:
    """Return a summary of the runs still to train, and the command of each."""
    left = [(each, seed, rest) for (each, seed), steps in zip(plan, done, strict=True) if (rest := each.steps - steps)]
    finished = f"{len(plan) - len(left)} of {len(plan)} runs are finished"
    if not left:
        return f"{finished}: figures and tables are written again", []
    about = f"{len(left)} runs, {jobs} at a time: {sum(rest for *_, rest in left):,} agent-steps"
    lines = [f"outlast train {' '.join(each.words(seed))}  # {rest:,} agent-steps" for each, seed, rest in left]
    return about + (f"; {finished}" if len(left) < len(plan) else ""), lines


def _train(plan: Plan, done: Sequence[int], options: argparse.Namespace, about: str, jobs: int) -> int:
    """Train the remaining runs. Return the exit status."""
    runs = [
        (ChildRun(each.folder(options.out, seed), each.words(seed), resume=True), each.steps, before)
        for (each, seed), before in zip(plan, done, strict=True)
    ]
    waiting = [run for run, steps, before in runs if before < steps]
    view = LiveView(sum(done), sum(steps for _, steps, _ in runs), quiet=options.quiet, about=about)
    return side_by_side(waiting, jobs, view, lambda: sum(min(s, max(run.steps(), before)) for run, s, before in runs))


def write_part(part: str, chosen: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Write all output of a part, and yield the path of each file once it is written.

    Figures and tables show all experiments of the part whose runs are in the folder; otherwise one game's would replace
    those of another. Corrected games that are not chosen are shown if they were measured before.

    chosen: The experiments to film. out: The output folder of the command. progress: Called with 1 after each long
    task. Raises TrainingError: runs are missing, or a file cannot be written.
    """
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


def _beside_the_paper(part: str, there: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Yield kept results, figures and tables."""
    runs = load_runs(place for each in there for place in each.results(out))
    yield from write_files(curves_to_keep(runs, out / part) | _policies(there, out))
    games = {each.game for each in there}
    others = [each for each in experiments([FIRST]) if part != FIRST and each.game in games]
    beside = load_runs(place for each in others for place in each.results(out))
    files = figures_and_tables(group_runs(runs), "png", group_runs(beside))
    yield from write_files({out / part / name: content for name, content in files.items()})
    progress(1)


def _mended(part: str, there: Sequence[Experiment], out: Path, progress: Counter) -> Iterator[Path]:
    """Yield kept policies, curves and measurements; a table, and a figure for each variant."""
    study = out / part
    curves, measured = kept_runs(study), mended.read_measured(study / mended.FILE)
    for each in there:
        for run in each.results(out):
            if run.is_dir():
                measured[run.name] = mended.measured(each.scenario, run)
                (result,) = load_runs([run])
                curves[run.name] = result.about, rounded(thinned(result.curves, POINTS), DIGITS)
            elif run.name not in measured:
                raise TrainingError(f"{study / mended.FILE} does not have {run.name}, and its folder is missing")
            progress(1)
    kept = {FILE: format_curves(dict(sorted(curves.items())))}
    kept |= {mended.FILE: mended.format_measured(measured.values())}
    shown = {each.name: [measured[run.name] for run in each.results(out)] for each in there}
    kept |= {"measured.md": (mended.table(shown) + "\n").encode()}
    yield from write_files({study / name: content for name, content in kept.items()} | _policies(there, out))
    changed = sorted({pair.partition("=")[0] for each in there for pair in each.numbers})
    runs = dict[str, list[Path]]()
    for each in there:
        runs.setdefault(each.game.partition("+")[0], []).extend(study / run.name for run in each.results(out))
    for name, own in runs.items():
        yield from plot(own, study / name, by=("scenario", *changed), curves=CURVES).files
        progress(1)


def _measured(run: Path, known: Mapping[str, Any]) -> bool:
    """Return whether a run was measured, by its folder or by kept results."""
    return (run / mended.FILE).exists() if run.is_dir() else run.name in known


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
        (written,) = write_files({path: small.read_bytes()})
    return written
