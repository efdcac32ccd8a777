"""outlast numbers: every number of a game, which --set changes."""

import argparse
from typing import Any

from ..scenarios.number_table import NumberRow, scenario_rows
from ..text_table import terminal_width, text_table
from .options import add_scenario, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the numbers of a game, with their values and meanings"
    description = (
        "List every number of a game, with its value here, the default of its mechanic, the allowed range, the unit "
        "and the meaning. --set changes any of them."
    )
    examples = [
        ("numbers ffa_2", "all numbers that --set can change"),
        ("numbers teams_3 --set room_size=30", "the same in a larger room: some numbers grow with it"),
    ]
    command = commands.add_parser("numbers", help=text, description=description, examples=examples, run=run)
    add_scenario(command)


def run(options: argparse.Namespace) -> int:
    """Print a table of them, by mechanics."""
    head = [name.replace("about", "meaning") for name in NumberRow._fields]
    print(text_table(scenario_rows(scenario(options)), head, width=terminal_width()))
    return 0
