"""reproduce: the paper's experiments and further ones, trained, measured and drawn in one command."""

import argparse
import heapq
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.available import available_cores
from outlast.envs.cli.options import STOPPED, add_quiet, nonnegative, output, positive
from outlast.envs.core.options import MACHINE, OUTPUT
from outlast.envs.errors import FilmError, install
from outlast.envs.progress import Progress, above_bars

from ..base.errors import TrainingError, needed
from ..base.files import check_out
from ..research.experiments import PARTS, Experiment, expected_seconds, experiments
from ..runs.child_runs import ChildRun, side_by_side
from ..runs.live_view import LiveView

Plan = list[tuple[Experiment, int]]  # with a seed
EXTRAS = "train,plot,view"
TIMED_ON = "as timed on one core of an AMD EPYC (Zen 3)"


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "train, measure and draw the paper's experiments and more"
    examples = [
        ("reproduce --plan", "the runs to train, with their time"),
        ("reproduce original --out reproduction", "the eight experiments; the same command continues after Ctrl-C"),
        ("reproduce original --only ffa_2 teams_2 --seeds 1", "two of them, one seed each"),
    ]
    description = (
        "Train the runs of docs/paper.md, and write its figures, tables and films. The same command continues after it "
        "was stopped."
    )
    parts = "\n".join(f"  {name:10}{about}" for name, about in PARTS.items())
    command = commands.add_parser(
        "reproduce", help=text, description=description, examples=examples, epilog=f"parts:\n{parts}"
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
    text = "only print the runs to train, with their approximate time"
    done.add_argument("--plan", action="store_true", help=text)
    add_quiet(command)
    text = "runs that train at the same time (default: cores)"
    command.group(MACHINE).add_argument("--jobs", type=positive, help=text)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command. Return the exit status."""
    options.out = Path(options.out)
    chosen = _chosen(options)
    plan = _plan(chosen, options)
    seconds, timed = expected_seconds([experiment for experiment, _ in plan])
    jobs = options.jobs or available_cores()
    about, lines = _summary(plan, seconds, timed, options.out, jobs)
    if options.plan:
        print("\n".join([about, *lines]))
        return 0
    try:  # ahead of hours of training
        with needed(EXTRAS, "this needs"):
            from outlast.envs.rendering.video.codecs import find_ffmpeg

            from ..research.output import write_part

            importlib.import_module("matplotlib")
        find_ffmpeg(".webm")
    except FilmError as error:
        raise TrainingError(f"the films need FFmpeg: {install(EXTRAS)}") from error
    status = _train(plan, seconds, options, about, jobs)
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


def _summary(
    plan: Plan, seconds: Sequence[float], timed: Sequence[bool], out: Path, jobs: int
) -> tuple[str, list[str]]:
    """Return a summary of the runs still to train, with the expected hours; and the command of each."""
    done = [min(1, each.steps_done(out, seed) / each.steps) for each, seed in plan]
    rest = [each * (1 - share) for each, share in zip(seconds, done, strict=True)]
    left = [k for k, share in enumerate(done) if share < 1]
    finished = f"{len(plan) - len(left)} of {len(plan)} runs are finished"
    if not left:
        return f"{finished}: figures and tables are written again", []
    hours = _end([rest[k] for k in left], jobs) / 3600
    guesses = sum(not timed[k] for k in left)
    source = f"an estimate, since {guesses} of them were never timed" if guesses else TIMED_ON
    about = f"{len(left)} runs, {jobs} at a time: about {hours:.1f} hours, {source}"
    lines = []
    for k in left:
        experiment, seed = plan[k]
        more = " left" * (done[k] > 0) + ", an estimate" * (not timed[k])
        lines.append(f"outlast train {' '.join(experiment.words(seed))}  # {rest[k] / 3600:.1f} h{more}")
    return about + (f"; {finished}" if len(left) < len(plan) else ""), lines


def _end(seconds: Sequence[float], jobs: int) -> float:
    """Return the estimated end of the last of these runs, `jobs` at a time; one begins when another has ended."""
    ends = [0.0] * jobs
    for each in seconds:
        heapq.heapreplace(ends, ends[0] + each)
    return max(ends)


def _train(plan: Plan, seconds: Sequence[float], options: argparse.Namespace, about: str, jobs: int) -> int:
    """Train the remaining runs. Return the exit status. Progress is counted in expected seconds."""
    runs = [ChildRun(each.folder(options.out, seed), each.words(seed), resume=True) for each, seed in plan]
    weights = [each / experiment.steps for (experiment, _), each in zip(plan, seconds, strict=True)]
    kept = [each.steps_done(options.out, seed) for each, seed in plan]
    waiting = [run for run, (each, _), done in zip(runs, plan, kept, strict=True) if done < each.steps]
    total = round(sum(seconds))

    def done() -> int:
        steps = (max(run.steps(), before) for run, before in zip(runs, kept, strict=True))
        return min(total, round(sum(weight * each for weight, each in zip(weights, steps, strict=True))))

    view = LiveView(done(), total, quiet=options.quiet, about=about, unit="core-seconds")
    return side_by_side(waiting, jobs, view, done)
