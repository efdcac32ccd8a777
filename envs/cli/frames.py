"""outlast frames: play, and draw every step, as pictures or as a film."""

import argparse
import dataclasses
from typing import Any

from ..films import STEPS, Count, film
from . import video_options
from .options import OPPONENTS, PLAY, add_common, add_number, add_others, add_policy, add_scenario, add_seed, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("frames teams_3 --out fight.webm", "a film of one world, in which the scripted policy plays 150 steps"),
        ("frames ffa_2 --policy random --steps 100 --out pictures", "numbered pictures in a folder"),
        (
            "frames ffa_3 --mosaic 2x2 --views +vision,-ids --out four.gif",
            "four worlds in one film, with what agents see",
        ),
    ]
    description = "Play worlds from the beginning, and draw every step, into a film or a folder of pictures."
    text = "play worlds and draw every step, as pictures or as a film"
    command = commands.add_parser("frames", help=text, description=description, examples=examples)
    add_scenario(command)
    played = command.group(PLAY)
    add_number(played, "--worlds", "as many as --mosaic has room for, or 1", "number of worlds to play and draw")
    add_number(played, "--steps", STEPS, "steps to play in each world")
    add_policy(command, "scripted")
    add_others(command, None, OPPONENTS)
    add_seed(command)
    video_options.add(command, required=True)
    add_common(command, "--quiet")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Play and draw; the exit status."""
    asked = scenario(options)
    given = {name: getattr(options, name) for name in ("policy", "others", "worlds", "steps", "seed")}

    def made(progress: Count) -> None:
        film(asked, options.out, progress=progress, **given, **dataclasses.asdict(video_options.looks(options)))

    return video_options.report(options, options.steps, made)
