"""outlast frames: play, and draw every step, as pictures or as a film."""

import argparse
import contextlib
import logging
from typing import Any

from ..core.make import make_vec
from ..rollout.local import ticks
from . import video_options
from .options import PLAY, add_common, add_number, add_policy, add_scenario, add_seed, scenario_and_policy

LOGGER = logging.getLogger(__name__)


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("frames teams_3 --out fight.webm", "a film of one world, 500 steps of the scripted policy"),
        ("frames ffa_2 --policy random --steps 100 --out pictures", "numbered pictures in a folder"),
        ("frames ffa_3 --mosaic 2x2 --views +vision,-ids --out four.gif", "four worlds, with what agents see"),
    ]
    description = "Play worlds from the beginning and draw every step: a film, or a folder of pictures."
    text = "play worlds and draw every step, as pictures or as a film"
    command = commands.add_parser("frames", help=text, description=description, examples=examples)
    add_scenario(command)
    played = command.group(PLAY)
    add_number(played, "--worlds", "as many as --mosaic has room for, or 1", "number of worlds")
    add_number(played, "--steps", 500, "steps of each world")
    add_policy(command, "scripted")
    add_seed(command)
    video_options.add(command, required=True)
    add_common(command, "--quiet")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Play and draw; the exit status."""
    rows, columns = options.mosaic or (1, 1)
    if options.mosaic and rows * columns < (options.worlds or 0):
        LOGGER.warning("--mosaic shows the first %d of %d worlds", rows * columns, options.worlds)
    scenario, make_policy = scenario_and_policy(options)
    env = make_vec(scenario, options.worlds or rows * columns, seed=options.seed, copy=False, check_actions=False)
    with contextlib.closing(env):
        played = ticks(env, make_policy(env, options.seed), options.steps)
        return video_options.write_frames(options, env.worlds, played, options.steps)
