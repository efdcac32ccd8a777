"""outlast numbers: every number of a game, which --set changes."""

import argparse
from typing import Any

from ..scenarios.number_table import as_columns, number_rows
from ..scenarios.scenario import sorted_
from .options import add_scenario, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("numbers", help="list the numbers of a game, with values, ranges, units and meanings")
    add_scenario(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print a table of them, by mechanics."""
    print(as_columns(row for module in sorted_(scenario(options)) for row in number_rows(module)))
    return 0
