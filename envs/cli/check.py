"""outlast check: play a game at random, and look for what its mechanics get wrong without an error."""

import argparse
from typing import Any

from ..api.check import CHECKS, check
from ..api.options import CheckOptions
from .options import add_options, add_scenario, given_options, scenario

FOUND = 1  # the exit status if something was found


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "play a game at random, and look for mistakes in its mechanics"
    description = (
        "Let random agents play a game, and look for mistakes in its mechanics that raise no error. The observed "
        "numbers must be finite and within their declared bounds. A world must come out the same when it is played "
        "again, without the other worlds, or from a saved state. And your own mechanics must do what they declare, "
        "and the same when they run as Python. The exit status is 1 if a mistake was found."
    )
    examples = [("check mygame.py:ARENA", "a game of your own, with all its mechanics")]
    command = commands.add_parser("check", help=text, description=description, examples=examples, run=run)
    add_scenario(command)
    add_options(command, CheckOptions)


def run(options: argparse.Namespace) -> int:
    """Print a line for each check, and what was found; the exit status."""
    width = max(map(len, CHECKS))

    def passed(name: str, text: str) -> None:
        print(f"{name:<{width}}  {text or 'ok'}", flush=True)

    found = check(scenario(options), **given_options(options, CheckOptions), passed=passed)
    return FOUND if found else 0
