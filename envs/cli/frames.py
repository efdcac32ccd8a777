"""outlast frames: play, and draw every step, as pictures or as a film."""

import argparse
from typing import Any

from ..api.film import Count, film
from ..api.options import FilmOptions, Looks
from . import video_options
from .options import add_options, add_quiet, add_scenario, given_options, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("frames teams_3 --out fight.webm", "a film of one world, in which the scripted policy plays 150 steps"),
        ("frames ffa_2 --policy random --steps 100 --out pictures", "numbered pictures in a folder"),
        ("frames ffa_3 --mosaic 2x2 --views +vision,-ids --out four.gif", "four worlds at once, and what agents see"),
    ]
    description = "Play worlds from the beginning, and draw every step, into a film or a folder of pictures."
    text = "play worlds and draw every step, as pictures or as a film"
    command = commands.add_parser("frames", help=text, description=description, examples=examples, run=run)
    add_scenario(command)
    add_options(command, FilmOptions)
    video_options.add(command, required=True)
    add_quiet(command)


def run(options: argparse.Namespace) -> int:
    """Play and draw; the exit status."""
    asked, given = scenario(options), given_options(options, FilmOptions) | given_options(options, Looks)

    def made(progress: Count) -> None:
        film(asked, options.out, progress=progress, **given)

    return video_options.report(options, options.steps, made)
