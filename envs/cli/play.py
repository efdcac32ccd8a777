"""outlast play: steer an agent in the browser, against policies."""

import argparse
import sys
from typing import Any

from ..api.options import FASTEST, PageOptions, PlayOptions
from ..api.play import play
from .options import add_options, add_scenario, given_options, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("play ffa_2", "a duel against the scripted policy"),
        ("play teams_3 --agent 2 --others random --fps 10", "you are agent 2 of 0 to 3, at a third of the speed"),
    ]
    description = (
        "Steer an agent with the keyboard, on a web page that opens in your browser. Without --host, only this machine "
        "can open it. Ctrl-C ends the game."
    )
    text = "steer an agent with the keyboard, in the browser, against policies"
    command = commands.add_parser("play", help=text, description=description, examples=examples, run=run)
    add_scenario(command)
    add_options(command, PlayOptions, fps={"type": _rate})
    add_options(command, PageOptions)


def run(options: argparse.Namespace) -> int:
    """Serve the game until Ctrl-C; the exit status. Raises PlayError."""
    play(scenario(options), **given_options(options, PlayOptions), **given_options(options, PageOptions))
    print(file=sys.stderr)  # behind the ^C
    return 0


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0
    if not 0 < value <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text}: a number above 0, up to {FASTEST}, is needed")
    return value
