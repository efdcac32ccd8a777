"""outlast evaluate: policies meet each other; win rates, ratings, what they do. Loads PyTorch only when it runs."""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from outlast.envs.commands.options import add_scenario, policy, positive, scenario, seed
from outlast.envs.errors import TrainingError


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("evaluate", help="let policies meet each other, and rate them")
    add_scenario(command)
    command.add_argument("policies", nargs="+", type=policy, metavar="POLICY", help="random, noop, scripted, FILE.zip")
    command.add_argument("--episodes", type=positive, default=1000, help="of each pairing, at least (default 1000)")
    command.add_argument("--worlds", type=positive, default=64, help="at once (default 64)")
    command.add_argument("--seed", type=seed, default=0, help="same seed, same numbers (default 0)")
    command.add_argument("--threads", type=positive, default=1, help="of the worlds; the numbers stay the same")
    command.add_argument("--out", type=Path, metavar="FOLDER", help="write the tables there, as CSV and JSON")
    command.add_argument("--film", action="store_true", help="and a film and a page of a typical episode each")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Evaluate and report; the exit status."""
    if options.film and options.out is None:
        raise TrainingError("--film needs --out FOLDER, for the films")
    try:
        from .contenders import contenders
        from .evaluate import Evaluation
    except ModuleNotFoundError as error:
        raise TrainingError(f"evaluating needs {error.name}: pip install 'outlast[train]'") from error
    numbers = {name: getattr(options, name) for name in ("episodes", "worlds", "seed", "threads")}
    evaluation = Evaluation(scenario(options), contenders(options.policies), **numbers)
    try:
        _make(options.out)
        return _watched(evaluation, options)
    finally:
        evaluation.close()


def _make(folder: Path | None) -> None:
    """Before anything is played: no evaluation shall be lost for the want of a place."""
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainingError(f"--out: {folder} cannot be a folder: {error.strerror}") from error


def _watched(evaluation: Any, options: argparse.Namespace) -> int:
    """Play behind a progress bar and report what is complete; the exit status."""
    start, status = time.perf_counter(), 0
    pairs, worlds = len(evaluation.pairs), evaluation.env.num_worlds
    bar = tqdm(total=pairs * evaluation.episodes, unit="episode", disable=options.quiet)
    files: list[Path] = []
    try:
        for pair in evaluation.pairs:
            files += _played(evaluation, pair, options, bar.update)
    except KeyboardInterrupt:
        status = 130
        print(f"stopped; complete are {len(evaluation.meetings)} of {pairs} pairings", file=sys.stderr)
    bar.close()
    print(f"{evaluation.scenario.name}, seed {evaluation.seed}: {len(evaluation.meetings)} pairings of ", end="")
    print(f"{evaluation.episodes:,} episodes, {evaluation.each} in each of {worlds} worlds; ", end="")
    print(f"{time.perf_counter() - start:,.0f} s\n")
    _report(evaluation, options.out, files)
    return status


def _played(
    evaluation: Any, pair: tuple[int, int], options: argparse.Namespace, progress: Callable[[int], Any]
) -> list[Path]:
    """Play a pairing; what was written of it."""
    if not options.film:
        evaluation.meet(pair, progress)
        return []
    from .showcase import shown

    return shown(evaluation, pair, options.out, progress)[1]


def _report(evaluation: Any, folder: Path | None, files: list[Path]) -> None:
    """Print the tables, write them if there is a folder, and name what was written."""
    from . import report

    print(report.text(evaluation))
    if folder is not None:
        print("", *report.write(evaluation, folder), *files, sep="\n")
