"""outlast frames: play, and draw every step, as pictures or as a film."""

import argparse
import contextlib
from typing import Any

from ..core.make import make_vec
from ..rollout.local import ticks
from . import video_options
from .options import add_policy, add_scenario, cast, positive


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("frames", help="draw worlds step by step, as pictures or as a film")
    add_scenario(command)
    command.add_argument("--worlds", type=positive, help="how many worlds (default: one, or what fills the mosaic)")
    command.add_argument("--steps", type=positive, default=500, help="steps of each world (default 500)")
    add_policy(command)
    video_options.add(command)
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run, policy="scripted")


def run(options: argparse.Namespace) -> int:
    """Play and draw; the exit status."""
    rows, columns = options.mosaic or (1, 1)
    worlds = options.worlds or rows * columns
    scenario, make_policy = cast(options)
    with contextlib.closing(make_vec(scenario, worlds, seed=options.seed, copy=False, check_actions=False)) as env:
        policy = make_policy(env, options.seed)
        return video_options.shoot(options, env.worlds, ticks(env, policy, options.steps), options.steps)
