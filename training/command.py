"""outlast train: train the agents of a variant as the paper did, or better. Loads PyTorch only when it runs."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from tqdm import tqdm

from outlast.envs.cli.options import add_scenario, positive, scenario, seed
from outlast.envs.errors import TrainingError
from outlast.envs.scenarios.scenario import Scenario

from . import several
from .presets import DEAD, PRESETS
from .settings import ROLLOUT, changed


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("train", help="train the agents of a variant with PPO")
    add_scenario(command, several=True)
    command.add_argument("--preset", choices=PRESETS, default="original", help="the networks (default original)")
    command.add_argument("--steps", type=count, default=10_000_000, help="agent-steps, such as 10e6 (the default)")
    command.add_argument("--seed", type=seed, nargs="+", default=[0], help="same seed, same numbers (default 0)")
    command.add_argument("--jobs", type=positive, help="runs at a time, where there are several (default: cores)")
    command.add_argument("--worlds", type=positive, default=64, help="that share a rollout (default 64; the paper: 1)")
    command.add_argument("--rollout", type=positive, default=ROLLOUT, help="environment steps of it (default 16384)")
    command.add_argument("--ppo", action="append", default=[], metavar="NAME=VALUE", help="of PPO: gamma=0.999")
    command.add_argument("--dead", choices=DEAD, default="keep", help="train on dead agents (keep) or not (drop)")
    command.add_argument("--device", default="cpu", help="cpu (the default), cuda")
    command.add_argument("--threads", type=positive, help="of networks and worlds (default: cores, at most 4)")
    command.add_argument(
        "--out", type=Path, help="folder of the run, or around several (default runs/VARIANT-PRESET-SEED)"
    )
    command.add_argument("--every", type=count, default=1_000_000, help="agent-steps between checkpoints (default 1e6)")
    command.add_argument("--resume", action="store_true", help="go on from the newest checkpoint in the folder")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Train; the exit status. Several variants or seeds are trained side by side."""
    chosen, settings = [scenario(options, name) for name in options.variant], changed(options.ppo)
    if len(options.variant) * len(options.seed) > 1:
        return several.train(options, [scenario.name for scenario in chosen])
    return _alone(options, chosen[0], settings)


def _alone(options: argparse.Namespace, chosen: Scenario, settings: dict[str, Any]) -> int:
    try:
        from .train import Plan, Run
    except ModuleNotFoundError as error:
        raise TrainingError(f"training needs {error.name}: pip install 'outlast[train]'") from error
    (own,), shared = options.seed, ("preset", "steps", "worlds", "rollout", "dead", "device", "every")
    numbers = {name: getattr(options, name) for name in shared}
    plan = Plan(chosen, seed=own, settings=settings, threads=options.threads or 0, **numbers)
    folder = options.out or Path("runs", f"{chosen.name}-{options.preset}-{own}")
    work = Run(plan, folder, resume=options.resume)
    return _watched(work, options.quiet)


def _watched(work: Any, quiet: bool) -> int:
    """Train behind a progress bar and say what came of it; the exit status."""
    begun, start, status = work.done, time.perf_counter(), 0
    bar = tqdm(total=work.plan.steps, initial=begun, unit="agent-step", unit_scale=True, disable=quiet)

    def progress(run: Any) -> None:
        bar.update(run.done - bar.n)
        bar.set_postfix(run.shown)

    try:
        work.go(progress)
    except KeyboardInterrupt:
        status = 130
        print("stopped: go on with --resume", file=sys.stderr)
    finally:
        bar.close()
    seconds = time.perf_counter() - start
    done = work.saved
    print(f"{done:,} agent-steps = {done // work.model.core.num_agents:,} environment steps in {work.folder}")
    print(f"{done - begun:,} agent-steps of them in {seconds:,.0f} s: {(done - begun) / seconds:,.0f} a second")
    return status


def count(text: str) -> int:
    """A number of steps of at least 1; 10e6 is one."""
    try:
        value = float(text)
    except ValueError:
        value = 0
    if value < 1 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text}: a whole number of at least 1 is needed")
    return int(value)
