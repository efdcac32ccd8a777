"""outlast train: train the agents of one or several variants; several runs are processes side by side."""

import argparse
import functools
import itertools
import logging
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.options import STOPPED, add_scenario, nonnegative, positive, scenario, seed
from outlast.envs.errors import install
from outlast.envs.rollout.mixture import parse_mixture
from outlast.envs.scenarios.scenario import Scenario

from ..annealing import parse_anneal
from ..children import RESUME, ChildRun, side_by_side
from ..config import CRITICS, FAST, OPPONENTS, POLICIES, SELF, SNAPSHOTS, TEACHERS, TrainingConfig, parse_warm_start
from ..errors import TrainingError
from ..hyperparameters import parse_hyperparameters
from ..live_view import LiveView
from ..presets import DEAD, PRESETS
from ..workload import Workload

GROUPS = {
    "what is learned": (
        *("--preset", "--steps", "--seed", "--ppo", "--anneal", "--policies", "--memory", "--critic", "--dead"),
        "--warm-start",
    ),
    "opponents": ("--opponents", "--prioritised", "--snapshots"),
    "a rollout": ("--worlds", "--rollout"),
    "output": ("--out", "--every", "--resume", "--film", "--quiet"),
    "machine": ("--device", "--threads", "--processes", "--jobs", "--ray", "--halves"),
}  # of help
OWN = ("variant", "seed", "out", "resume", "quiet", "jobs", "save_scenario")  # that each of several runs has for itself
NUMBERS = (
    *("preset", "steps", "worlds", "rollout", "policies", "prioritised", "snapshots", "memory", "critic", "dead"),
    *("device", "processes", "halves", "every", "warm_start"),
)  # options that TrainingConfig takes as they are
logger = logging.getLogger("outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("train ffa_2", "ten million agent-steps into runs/ffa_2-fast-0"),
        ("train ffa_2 teams_2 --seed 0 1 2 --steps 20e6", "six runs, as many at a time as there are cores"),
        ("train ffa_2 --resume", "go on with a run"),
    ]
    text = "train the agents of a variant with PPO"
    description = (
        "Train with PPO, by self-play unless --opponents names others; a run's folder has log and checkpoints."
    )
    command = commands.add_parser("train", help=text, description=description, examples=examples)
    add_scenario(command, several=True)
    command.add_argument("--preset", choices=PRESETS, default=FAST, help="networks and numbers of PPO (default fast)")
    command.add_argument("--steps", type=positive, default=10_000_000, help="agent-steps, such as 10e6 (the default)")
    command.add_argument("--seed", type=seed, nargs="+", default=[0], help="same seed, same numbers (default 0)")
    command.add_argument("--jobs", type=positive, help="runs at a time, where there are several (default: cores)")
    command.add_argument("--worlds", type=positive, default=0, help="that share a rollout (the paper: 1)")
    command.add_argument("--rollout", type=positive, default=0, help="environment steps of it (the paper: 16384)")
    command.add_argument("--ppo", action="append", default=[], metavar="NAME=VALUE", help="of PPO: gamma=0.999")
    command.add_argument(
        "--policies", choices=POLICIES, default="shared", help="one for all agents, or one for each side or agent"
    )
    text = f"who they play against, with weights: {', '.join(OPPONENTS)}, FILE.zip or a run's folder (default self)"
    command.add_argument("--opponents", default=SELF, metavar="NAME:WEIGHT,...", help=text)
    text = "draw opponents the more often, the more they win"
    command.add_argument("--prioritised", action="store_true", help=text)
    command.add_argument(
        "--snapshots", type=positive, default=SNAPSHOTS, help="updates between past selves (default 10)"
    )
    text = "numbers that each agent keeps from step to step (default 0)"
    command.add_argument("--memory", type=nonnegative, default=0, metavar="N", help=text)
    text = "values are learned from what the agent observes (own, the default), or from the whole world, too (state)"
    command.add_argument("--critic", choices=CRITICS, default="own", help=text)
    text = f"before: imitate {', '.join(TEACHERS)}, or FILE.zip:STEPS, or begin with the weights of FILE.zip (or a run)"
    command.add_argument("--warm-start", default="", metavar="NAME[:STEPS]", help=text)
    text = "change a number of the game in training: rewards_kill=10:0@5e6 (may be given several times)"
    command.add_argument("--anneal", action="append", default=[], metavar="NUMBER=FROM:TO[@STEPS]", help=text)
    command.add_argument("--dead", choices=DEAD, default="keep", help="train on dead agents (keep) or not (drop)")
    command.add_argument("--device", default="cpu", help="where policies are updated: cpu (the default), cuda")
    command.add_argument("--threads", type=positive, help="of networks and worlds (default: cores, at most 4)")
    text = "that share the worlds; the numbers are the same, but for rounding (default 1)"
    command.add_argument("--processes", type=positive, default=1, metavar="N", help=text)
    text = "run all of them but one on the Ray cluster at ADDRESS, or the one on this machine (default: none)"
    command.add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help=text)
    text = "step half of the worlds while the networks are busy with the other half"
    command.add_argument("--halves", action="store_true", help=text)
    command.add_argument(
        "--out", type=Path, help="folder of the run, or around several (default runs/VARIANT-PRESET-SEED)"
    )
    command.add_argument(
        "--every", type=positive, default=1_000_000, help="agent-steps between checkpoints (default 1e6)"
    )
    command.add_argument("--resume", action="store_true", help="go on from the newest checkpoint in the folder")
    command.add_argument("--film", action="store_true", help="make a short film at each checkpoint, beside it")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.arrange(GROUPS)
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
    try:
        from ..run import TrainingRun
        from ..train import shown, usual_folder
    except ModuleNotFoundError as error:
        raise TrainingError(f"training needs {error.name}: {install('train')}") from error
    config = _config(options, chosen, options.seed[0], settings)
    folder = options.out or usual_folder(config)
    training = TrainingRun(config, folder, resume=options.resume, film=options.film, cluster=options.ray)
    begun, start, status = training.done, time.perf_counter(), 0
    try:
        shown(training, quiet=options.quiet)
    except KeyboardInterrupt:
        status = STOPPED
        logger.warning(RESUME)
    seconds, done = time.perf_counter() - start, training.saved
    print(f"{done:,} agent-steps = {done // training.trainer.env.num_agents:,} environment steps in {folder}")
    print(f"{done - begun:,} agent-steps of them in {seconds:,.0f} s: {(done - begun) / seconds:,.0f} a second")
    return status


def _config(options: argparse.Namespace, chosen: Scenario, own: int, settings: dict[str, Any]) -> TrainingConfig:
    """What the options ask for, of one scenario and one seed. Raises TrainingError."""
    numbers = {name: getattr(options, name) for name in NUMBERS}
    numbers["opponents"] = parse_mixture(options.opponents, OPPONENTS)
    numbers["anneal"] = parse_anneal(options.anneal)
    return TrainingConfig(chosen, seed=own, settings=settings, threads=options.threads or 0, **numbers)


def _train_several(
    command: Parser, options: argparse.Namespace, chosen: Sequence[tuple[str, Scenario]], settings: dict[str, Any]
) -> int:
    """Train every variant with every seed; the exit status, see side_by_side.

    `--resume` goes on with runs that were stopped, and begins those that had not begun.

    Args:
        command: Whose options these are.
        options: All of them.
        chosen: Names, as the user gave them, and their scenarios.
        settings: Of PPO.

    Raises:
        TrainingError: Two runs would be the same; nothing has begun then.
    """
    pairs, folder = list(itertools.product(chosen, options.seed)), options.out or Path("runs")
    common = [*command.words(options, leave_out=OWN), *(["--threads=1"] if options.threads is None else [])]
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
    at_once = options.jobs or max(1, (os.cpu_count() or 1) // options.processes)
    works = [Workload.of(_config(options, scenario, seed, settings)) for (_, scenario), seed in pairs]
    total = sum(work.total for work in works)
    about = f"{len(runs)} runs, {min(at_once, len(runs))} at a time, {total:,} agent-steps; the first: {works[0]}"
    begun = sum(run.steps() for run in runs) if options.resume else 0
    view = LiveView(begun, total, quiet=options.quiet, about=about)
    return side_by_side(runs, at_once, view, lambda: sum(run.steps() for run in runs))
