"""outlast evaluate: policies play against each other; win rates, ratings, behaviour."""

import argparse
import contextlib
import logging
import tempfile
import time
from pathlib import Path
from typing import Any

from tqdm import tqdm

from outlast.envs.cli.options import add_scenario, policy, positive, scenario, seed
from outlast.envs.errors import install
from outlast.envs.recording import record

from ..errors import TrainingError

logger = logging.getLogger("outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("evaluate", help="let policies play against each other, and rate them")
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
        from ..evaluation.evaluation import Evaluation, contenders
    except ModuleNotFoundError as error:
        raise TrainingError(f"evaluating needs {error.name}: {install('train')}") from error
    numbers = {name: getattr(options, name) for name in ("episodes", "worlds", "seed", "threads")}
    evaluation = Evaluation(scenario(options), contenders(options.policies), **numbers)
    try:
        _make_folder(options.out)
        return _evaluate(evaluation, options)
    finally:
        evaluation.close()


def _make_folder(folder: Path | None) -> None:
    """Before anything is played, so that no evaluation is lost for want of a place."""
    try:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainingError(f"--out: {folder} cannot be a folder: {error.strerror}") from error


def _evaluate(evaluation: Any, options: argparse.Namespace) -> int:
    """Play behind a progress bar and report what is complete, also after an error; the exit status."""
    with tempfile.TemporaryDirectory() as hidden:
        recordings = Path(hidden) if options.film else None
        start, status = time.perf_counter(), 0
        try:
            _play(evaluation, options, recordings)
        except KeyboardInterrupt:
            status = 130
            complete, total = len(evaluation.pairings), len(evaluation.pairs)
            logger.warning("stopped; complete are %d of %d pairings", complete, total)
        finally:
            _report(evaluation, options.out, time.perf_counter() - start)
        if recordings and not status:
            status = _make_films(evaluation, recordings, options.out)
    return status


def _play(evaluation: Any, options: argparse.Namespace, recordings: Path | None) -> None:
    """Play every pairing; where there is a folder for tables, those of what is complete are always in it."""
    from ..evaluation import report

    total = len(evaluation.pairs) * evaluation.episodes
    with tqdm(total=total, unit="episode", disable=options.quiet) as bar:
        for pair in evaluation.pairs:
            with record(evaluation.env, _recording(recordings, pair)) if recordings else contextlib.nullcontext():
                evaluation.play_pair(pair, bar.update)
            if options.out is not None:
                report.write_tables(evaluation, options.out)


def _make_films(evaluation: Any, recordings: Path, folder: Path) -> int:
    """Make films and pages, and print the path of each when it is there; the exit status."""
    from ..evaluation.showcase import show_pairing

    try:
        for pairing in evaluation.pairings:
            made = show_pairing(evaluation, pairing, _recording(recordings, pairing.pair), folder)
            print(*made, sep="\n", flush=True)
    except KeyboardInterrupt:
        logger.warning("stopped; the tables are written, not all films are")
        return 130
    return 0


def _recording(folder: Path, pair: tuple[int, int]) -> Path:
    return folder / f"{pair[0]}-{pair[1]}.rec"


def _report(evaluation: Any, folder: Path | None, seconds: float) -> None:
    """Print the tables, write them if there is a folder, and print their paths. Raises TrainingError."""
    from ..evaluation import report

    played, worlds = len(evaluation.pairings), evaluation.env.num_worlds
    print(f"{evaluation.scenario.name}, seed {evaluation.seed}: {played} pairings of ", end="")
    print(f"{evaluation.episodes:,} episodes, {evaluation.each} in each of {worlds} worlds; {seconds:,.0f} s\n")
    print(report.text(evaluation), flush=True)
    if folder is not None:
        print("", *report.write_tables(evaluation, folder), sep="\n", flush=True)
