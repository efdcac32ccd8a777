"""outlast frames: play, and draw every step, as pictures or as a film."""

import argparse
import contextlib
from typing import Any

from ..core.make import make_vec
from ..rollout.local import ticks
from . import video_options
from .options import add_common, add_number, add_policy, add_scenario, add_seed, scenario_and_policy


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("frames", help="play worlds and draw every step, as pictures or as a film")
    add_scenario(command)
    add_number(command, "--worlds", "as many as --mosaic has room for, or 1", "number of worlds")
    add_number(command, "--steps", 500, "steps of each world")
    add_policy(command, "scripted")
    add_seed(command)
    video_options.add(command, required=True)
    add_common(command, "--quiet")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Play and draw; the exit status."""
    rows, columns = options.mosaic or (1, 1)
    scenario, make_policy = scenario_and_policy(options)
    env = make_vec(scenario, options.worlds or rows * columns, seed=options.seed, copy=False, check_actions=False)
    with contextlib.closing(env):
        played = ticks(env, make_policy(env, options.seed), options.steps)
        return video_options.write_frames(options, env.worlds, played, options.steps)
