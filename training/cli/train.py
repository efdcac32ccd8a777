"""outlast train: train the agents of one or several variants; several runs are processes side by side."""

import argparse
import functools
import itertools
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.available import available_cores
from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.options import STOPPED, add_options, add_scenario, given_options, output, positive, scenario, seed
from outlast.envs.core.options import options_of
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.scenario import Scenario

from ..base import config as known
from ..base.annealing import parse_anneal
from ..base.config import OPPONENTS, SELF, RunOptions, TrainingConfig, Workload, parse_warm_start
from ..base.errors import TrainingError, needed
from ..base.files import check_out
from ..base.hyperparameters import parse_hyperparameters
from ..runs.child_runs import RESUME, ChildRun, side_by_side
from ..runs.live_view import LiveView

OWN = ("variant", "seed", "out", "resume", "quiet", "jobs", "save_scenario")  # that each of several runs has for itself
logger = logging.getLogger("outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("train ffa_2", "ten million agent-steps, in the folder runs/ffa_2-fast-0"),
        ("train ffa_2 teams_2 --seed 0 1 2 --steps 20e6", "six runs, as many at a time as there are cores"),
        ("train ffa_2 --resume", "go on with a run that was stopped"),
    ]
    text = "train the agents of a game with PPO"
    description = (
        "Train agents with PPO, by self-play unless --opponents names others. Several variants or seeds are several "
        "runs, side by side. The folder of a run has its log and checkpoints. A tick of a world of four agents is one "
        "environment step, and four agent-steps."
    )
    command = commands.add_parser("train", help=text, description=description, examples=examples)
    add_scenario(command, several=True)
    for title in (known.LEARNED, known.OPPOSED, known.ROLLOUT, known.OUTPUT, known.MACHINE):  # in this order
        command.group(title)
    text = f"seeds, with a run for each; {options_of(TrainingConfig)['seed'].text} (default 0)"
    seeds = {"type": seed, "nargs": "+", "default": [0], "help": text}
    add_options(command, TrainingConfig, seed=seeds, opponents={"default": SELF})
    add_options(command, RunOptions, folder={"type": output(check_out)}, cluster={"nargs": "?", "const": ""})
    text = "how many of several runs train at the same time (default: cores / --processes)"
    command.group(known.MACHINE).add_argument("--jobs", type=positive, help=text)
    command.set_defaults(run=functools.partial(run, command))


def run(command: Parser, options: argparse.Namespace) -> int:
    """Train; the exit status."""
    chosen, settings = [scenario(options, name) for name in options.variant], parse_hyperparameters(options.ppo)
    parse_warm_start(options.warm_start), parse_anneal(options.anneal)  # ahead of several processes
    if len(options.variant) * len(options.seed) > 1:
        return _train_several(command, options, list(zip(options.variant, chosen, strict=True)), settings)
    return _train_one(options, chosen[0], settings)


def _train_one(options: argparse.Namespace, chosen: Scenario, settings: dict[str, Any]) -> int:
    """Train in this process, behind a progress bar; the exit status."""
    if options.jobs is not None:
        raise TrainingError("--jobs has no effect on one run: leave it out, or name several variants or seeds")
    with needed("train", "training needs"):
        from ..runs.run import TrainingRun
        from ..runs.train import shown, usual_folder
    config = _config(options, chosen, options.seed[0], settings)
    folder = Path(options.out) if options.out else usual_folder(config)
    training = TrainingRun(config, folder, resume=options.resume, film=options.film, cluster=options.ray)
    begun, start, status = training.done, time.perf_counter(), 0
    try:
        shown(training, quiet=options.quiet)
    except KeyboardInterrupt:
        status = STOPPED
        logger.warning(RESUME)
    seconds, done = time.perf_counter() - start, training.saved
    print(f"{folder}: {done:,} agent-steps, which are {done // training.trainer.env.num_agents:,} environment steps")
    print(f"trained {done - begun:,} agent-steps in {seconds:,.0f} s: {(done - begun) / seconds:,.0f} a second")
    return status


def _config(options: argparse.Namespace, chosen: Scenario, own: int, settings: dict[str, Any]) -> TrainingConfig:
    """Return what the options ask for, of one scenario and one seed. Raises TrainingError."""
    parsed = {"seed": own, "settings": settings, "anneal": parse_anneal(options.anneal)}
    parsed["opponents"] = parse_lineup(options.opponents, OPPONENTS)
    return TrainingConfig(chosen, **given_options(options, TrainingConfig) | parsed)


def _train_several(
    command: Parser, options: argparse.Namespace, chosen: Sequence[tuple[str, Scenario]], settings: dict[str, Any]
) -> int:
    """Train every variant with every seed; the exit status, see side_by_side.

    `--resume` goes on with runs that were stopped, and begins those that had not begun.

    command: Whose options these are. chosen: Names, as the user gave them, and their scenarios. Raises TrainingError:
    two runs would be the same; nothing has begun then.
    """
    pairs, folder = list(itertools.product(chosen, options.seed)), Path(options.out or "runs")
    common = [*command.words(options, leave_out=OWN), *(["--threads=1"] if not options.threads else [])]
    runs = [
        ChildRun(
            folder / f"{scenario.file_name}-{options.preset}-{seed}",
            [variant, "--seed", str(seed), *common],
            resume=options.resume,
        )
        for (variant, scenario), seed in pairs
    ]
    if len({run.name for run in runs}) < len(runs):
        raise TrainingError(f"{', '.join(run.name for run in runs)}: name each variant and each seed once")
    at_once = options.jobs or max(1, available_cores() // options.processes)
    works = [Workload.of(_config(options, scenario, seed, settings)) for (_, scenario), seed in pairs]
    total = sum(work.total for work in works)
    about = f"{len(runs)} runs, {min(at_once, len(runs))} at a time, {total:,} agent-steps; the first: {works[0]}"
    begun = sum(run.steps() for run in runs) if options.resume else 0
    if options.resume and (anew := [run.name for run in runs if not checkpoints(run.folder)]):
        about += f"\nno checkpoint yet, begins at 0: {', '.join(anew)}"
    view = LiveView(begun, total, quiet=options.quiet, about=about)
    return side_by_side(runs, at_once, view, lambda: sum(run.steps() for run in runs))
