"""outlast train: train the agents of one or several variants; several runs are processes side by side."""

import argparse
import copy
import functools
import itertools
import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from outlast.ecs.kernels.available import available_cores
from outlast.envs.api.options import options_of
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import STOPPED, add_options, add_scenario, given_options, output, positive, scenario, seed
from outlast.envs.errors import needed
from outlast.envs.rollout.saved import checkpoints

from ..base import config as known
from ..base.config import SELF, RunOptions, TrainingConfig
from ..base.errors import TrainingError
from ..base.files import check_out
from ..base.presets import KINDS
from ..base.quantities import LiveView
from ..runs.child_runs import RESUME, ChildRun, side_by_side
from ..runs.train import shown

# options that differ between several runs
OWN = ("variant", "seed", "sweep", "out", "resume", "quiet", "jobs", "save_scenario")
logger = logging.getLogger("outlast")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "train", run)
    command.set_defaults(run=functools.partial(run, command=command))
    add_scenario(command, several=True)
    for title in (known.LEARNED, known.OPPOSED, known.ROLLOUT, known.OUTPUT, known.MACHINE):  # in this order
        command.group(title)
    text = f"seeds, with a run for each; {options_of(TrainingConfig)['seed'].text} (default 0)"
    seeds = {"type": seed, "nargs": "+", "default": [0], "help": text}
    add_options(command, TrainingConfig, seed=seeds, opponents={"default": SELF})
    add_options(command, RunOptions, folder={"type": output(check_out)}, cluster={"nargs": "?", "const": ""})
    text = "train with each of these values of a number of the game or of PPO, as in melee_damage=5,10,20 or gamma="
    text += "0.99,0.999; of several numbers, with each combination (can be repeated)"
    command.group(known.LEARNED).add_argument(
        "--sweep", type=_swept, action="append", default=[], metavar="NUMBER=V,V,...", help=text
    )
    text = "runs that train at the same time (default: cores / --processes)"
    command.group(known.MACHINE).add_argument("--jobs", type=positive, help=text)


def run(options: argparse.Namespace, command: Any = None) -> int:
    """Train the agents of a game with PPO.

    Train agents with PPO, by self-play unless --opponents names others. Several variants, seeds or values of --sweep
    are several runs, side by side. The folder of a run has its log and checkpoints. A tick of a world of four agents is
    one environment step, and four agent-steps.

    Examples:
        train ffa_2  # ten million agent-steps, in the folder runs/ffa_2-fast-0
        train ffa_2 teams_2 --seed 0 1 2 --steps 20e6  # six runs, as many at a time as there are cores
        train ffa_2 --sweep melee_damage=5,10,20 --seed 0 1  # a study of six runs; `outlast plot runs` compares them
        train ffa_2 --resume  # continue a run that was stopped
    """
    runs = list(_each_run(options))
    if options.jobs is not None and len(runs) == 1:
        raise TrainingError("--jobs has no effect on one run: leave it out, or name several variants or seeds")
    return _train_several(command, options, runs) if len(runs) > 1 else _train_one(options, runs[0])


class PlannedRun(NamedTuple):
    """A run that the options request."""

    config: TrainingConfig
    folder_name: str  # unless the user gives one
    words: tuple[str, ...]  # of a command line, those that only this run has


def _swept(text: str) -> tuple[str, ...]:
    """Return a value of --sweep as assignments: "gamma=0.9", "gamma=0.99"."""
    name, _, values = text.partition("=")
    given = [value.strip() for value in values.split(",")]
    if not name or not all(given) or len(set(given)) < len(given):
        raise argparse.ArgumentTypeError(f"{text}: must be a number and different values, as in melee_damage=5,10,20")
    return tuple(f"{name.strip()}={value}" for value in given)


def _each_run(options: argparse.Namespace) -> Iterator[PlannedRun]:
    """Yield all requested runs.

    Raises TrainingError, ScenarioError, NumberError: A number does not exist, or is given twice.
    """
    if options.sweep and options.save_scenario is not None:
        raise TrainingError("--save-scenario writes one scenario, and --sweep makes several: leave one of them out")
    for name, values, own in itertools.product(options.variant, itertools.product(*options.sweep), options.seed):
        ppo = tuple(text for text in values if text.partition("=")[0].rpartition(":")[2] in KINDS)
        numbers = [text for text in values if text not in ppo]
        for text in numbers:
            scenario(options, name).find_number(text.partition("=")[0], KINDS)  # its error also lists those of PPO
        asked = copy.copy(options)
        asked.set, asked.ppo = [*options.set, *numbers], [*options.ppo, *ppo]
        game = scenario(asked, name)
        config = TrainingConfig(game, **given_options(asked, TrainingConfig) | {"seed": own})
        swept = (*(f"--set={text}" for text in numbers), *(f"--ppo={text}" for text in ppo))
        yield PlannedRun(config, config.folder_name(*ppo), (name, "--seed", str(own), *swept))
        options.changed_scenario = getattr(asked, "changed_scenario", None)


def _train_one(options: argparse.Namespace, planned: PlannedRun) -> int:
    """Train in this process with a progress bar. Return the exit status."""
    with needed("train", "training needs {}", TrainingError):
        from ..runs.run import TrainingRun
    folder = Path(options.out or Path("runs", planned.folder_name))
    training = TrainingRun(planned.config, folder, resume=options.resume, film=options.film, cluster=options.ray)
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


def _train_several(command: Any, options: argparse.Namespace, planned: Sequence[PlannedRun]) -> int:
    """Train all of them, each in its own process. Return the exit status, see side_by_side.

    `--resume` continues runs that were stopped, and begins those that had not begun. Raises TrainingError, before
    anything begins: two runs would be the same.
    """
    folder = Path(options.out or "runs")
    common = [*command.words(options, leave_out=OWN), *(["--threads=1"] if not options.threads else [])]
    runs = [ChildRun(folder / each.folder_name, [*each.words, *common], resume=options.resume) for each in planned]
    if len({run.name for run in runs}) < len(runs):
        raise TrainingError(f"{', '.join(run.name for run in runs)}: name each variant and each seed once")
    at_once = options.jobs or max(1, available_cores() // options.processes)
    total, first = sum(each.config.total for each in planned), planned[0].config.workload
    about = f"{len(runs)} runs, {min(at_once, len(runs))} at a time, {total:,} agent-steps; the first: {first}"
    begun = sum(run.steps() for run in runs) if options.resume else 0
    if options.resume and (anew := [run.name for run in runs if not checkpoints(run.folder)]):
        about += f"\nno checkpoint yet, begins at 0: {', '.join(anew)}"
    view = LiveView(begun, total, quiet=options.quiet, about=about)
    return side_by_side(runs, at_once, view, lambda: sum(run.steps() for run in runs))
