"""outlast numbers: every number of a game, which --set changes."""

import argparse
from typing import Any

from ..scenarios.number_table import as_columns, scenario_rows
from .options import add_scenario, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the numbers of a game, with values, ranges, units and meanings"
    description = "List every number of a game: its value, default, range, unit and meaning. --set changes any of them."
    examples = [
        ("numbers ffa_2", "all that --set takes"),
        ("numbers teams_3 --set room_size=30", "what they are after a change, and which ones follow it"),
    ]
    command = commands.add_parser("numbers", help=text, description=description, examples=examples)
    add_scenario(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print a table of them, by mechanics."""
    print(as_columns(scenario_rows(scenario(options))))
    return 0
