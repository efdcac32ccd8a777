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
from outlast.envs.cli.options import CLUSTER, STOPPED, add_scenario, nonnegative, output, positive, scenario, seed
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import SAVED_AS, checkpoints
from outlast.envs.scenarios.scenario import Scenario

from ..base import config as known
from ..base.annealing import parse_anneal
from ..base.config import FAST, OPPONENTS, SELF, TrainingConfig, Workload, parse_warm_start
from ..base.errors import TrainingError, needed
from ..base.files import check_out
from ..base.hyperparameters import KINDS, parse_hyperparameters
from ..base.presets import DEAD, PRESETS
from ..runs.child_runs import RESUME, ChildRun, side_by_side
from ..runs.live_view import LiveView

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
PRESET = (
    "networks, numbers of PPO and size of a rollout: fast (the default); original, what the paper's authors ran; "
    "paper, what the paper's text says; scaled, which is paper with inputs of about -1 to 1"
)
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
    command.add_argument("--preset", choices=PRESETS, default=FAST, help=PRESET)
    text = "agent-steps to train for, rounded up to whole rollouts (default 10e6)"
    command.add_argument("--steps", type=positive, default=10_000_000, help=text)
    text = "seeds, with a run for each; the same seed gives the same numbers (default 0)"
    command.add_argument("--seed", type=seed, nargs="+", default=[0], help=text)
    text = "how many of several runs train at the same time (default: cores / --processes)"
    command.add_argument("--jobs", type=positive, help=text)
    text = (
        "worlds that are stepped together (default: fast has 512 agents in all, other presets 64 worlds; the paper: 1)"
    )
    command.add_argument("--worlds", type=positive, default=0, help=text)
    text = "environment steps of all worlds together between two updates (default: fast 128 for each world, other "
    text += "presets 16384, as in the paper)"
    command.add_argument("--rollout", type=positive, default=0, help=text)
    text = f"change a number of PPO, as in gamma=0.999: {', '.join(KINDS)} (can be repeated)"
    command.add_argument("--ppo", action="append", default=[], metavar="NAME=VALUE", help=text)
    text = "train one policy for all agents (shared, the default), one for each side, or one for each agent"
    command.add_argument("--policies", choices=known.POLICIES, default="shared", help=text)
    text = (
        "whom the agents play against, with weights, as in self:0.5,past:0.5. self is the policy itself, past one of "
    )
    text += f"its earlier selves; also {', '.join(OPPONENTS[2:])}, {SAVED_AS} (default self)"
    command.add_argument("--opponents", default=SELF, metavar="NAME:WEIGHT,...", help=text)
    text = "draw an opponent the more often, the more games it wins"
    command.add_argument("--prioritised", action="store_true", help=text)
    text = "with opponent past: number of updates until another earlier self is kept (default 10)"
    command.add_argument("--snapshots", type=positive, default=known.SNAPSHOTS, help=text)
    text = "how many numbers each agent remembers from step to step (default 0: no memory)"
    command.add_argument("--memory", type=nonnegative, default=0, metavar="N", help=text)
    text = "learn values from what the agent observes (own, the default), or from that and the state of the whole world"
    command.add_argument("--critic", choices=known.CRITICS, default="own", help=f"{text} (state)")
    text = f"begin by imitating {', '.join(known.TEACHERS)} (for STEPS agent-steps, by default 1.5e6) or "
    text += "FILE.zip:STEPS, or begin with the weights of FILE.zip; the folder of a run stands for its newest file "
    text += "(default: no such start)"
    command.add_argument("--warm-start", default="", metavar="NAME[:STEPS]", help=text)
    text = "change a number of the game linearly during training: rewards_kill=10:0@5e6 goes from 10 to 0 in the first "
    text += "5 million agent-steps, and without @5e6 in the whole run (can be repeated)"
    command.add_argument("--anneal", action="append", default=[], metavar="NUMBER=FROM:TO[@STEPS]", help=text)
    text = "learn also from the steps of dead agents (keep, the default), or leave them out (drop)"
    command.add_argument("--dead", choices=DEAD, default="keep", help=text)
    text = "PyTorch's device on which policies are updated, such as cuda; they always play on the CPU (default cpu)"
    command.add_argument("--device", default="cpu", help=text)
    text = "threads of each process, with the same results (default: cores / --processes; of several runs 1)"
    command.add_argument("--threads", type=positive, help=text)
    text = "processes that share the worlds of a run, with the same results up to rounding (default 1)"
    command.add_argument("--processes", type=positive, default=1, metavar="N", help=text)
    text = f"have all --processes but the first on the Ray cluster at ADDRESS; {CLUSTER} (default: no cluster)"
    command.add_argument("--ray", nargs="?", const="", metavar="ADDRESS", help=text)
    text = "step one half of the worlds while the networks choose actions for the other half, with the same results up "
    command.add_argument("--halves", action="store_true", help=f"{text}to rounding")
    text = "folder of the run, or the folder around those of several runs (default runs/VARIANT-PRESET-SEED)"
    command.add_argument("--out", type=output(check_out), help=text)
    text = "agent-steps between two checkpoints (default 1e6)"
    command.add_argument("--every", type=positive, default=1_000_000, help=text)
    text = "go on from the newest checkpoint in the folder of the run"
    command.add_argument("--resume", action="store_true", help=text)
    text = "make a short film of each checkpoint, a .webm file beside it"
    command.add_argument("--film", action="store_true", help=text)
    command.add_argument("--quiet", action="store_true", help="show no progress bar")
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
    numbers = {name: getattr(options, name) for name in (*known.AS_GIVEN, "warm_start")}
    numbers["opponents"] = parse_lineup(options.opponents, OPPONENTS)
    numbers["anneal"] = parse_anneal(options.anneal)
    return TrainingConfig(chosen, seed=own, settings=settings, threads=options.threads or 0, **numbers)


def _train_several(
    command: Parser, options: argparse.Namespace, chosen: Sequence[tuple[str, Scenario]], settings: dict[str, Any]
) -> int:
    """Train every variant with every seed; the exit status, see side_by_side.

    `--resume` goes on with runs that were stopped, and begins those that had not begun.

    command: Whose options these are. chosen: Names, as the user gave them, and their scenarios. Raises TrainingError:
    two runs would be the same; nothing has begun then.
    """
    pairs, folder = list(itertools.product(chosen, options.seed)), Path(options.out or "runs")
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
    at_once = options.jobs or max(1, available_cores() // options.processes)
    works = [Workload.of(_config(options, scenario, seed, settings)) for (_, scenario), seed in pairs]
    total = sum(work.total for work in works)
    about = f"{len(runs)} runs, {min(at_once, len(runs))} at a time, {total:,} agent-steps; the first: {works[0]}"
    begun = sum(run.steps() for run in runs) if options.resume else 0
    if options.resume and (anew := [run.name for run in runs if not checkpoints(run.folder)]):
        about += f"\nno checkpoint yet, begins at 0: {', '.join(anew)}"
    view = LiveView(begun, total, quiet=options.quiet, about=about)
    return side_by_side(runs, at_once, view, lambda: sum(run.steps() for run in runs))
