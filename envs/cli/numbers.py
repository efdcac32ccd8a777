"""outlast numbers: every number of a game, which --set changes."""

import argparse
from typing import Any

from ..scenarios.number_table import as_columns, number_rows
from ..scenarios.scenario import sorted_
from .options import add_scenario, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("numbers ffa_2", "every number of that game, by mechanics"),
        ("numbers ffa_2 --set melee_damage=20", "what a changed game has"),
    ]
    description = "List every number of a game with its value, range, unit and meaning: what --set changes."
    text = "list the numbers of a game, with values, ranges, units and meanings"
    command = commands.add_parser("numbers", help=text, description=description, examples=examples)
    add_scenario(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print a table of them, by mechanics."""
    print(as_columns(row for module in sorted_(scenario(options)) for row in number_rows(module)))
    return 0
