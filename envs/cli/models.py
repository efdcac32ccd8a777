"""outlast models: the trained policies that are kept, by name."""

import argparse
from typing import Any

from ..rollout.saved import models
from ..text_table import text_table

HEADS = ("preset", "seed", "agent-steps", " wins", "  bytes", "SHA-256", "name")
SHORT = 12  # digits of a checksum


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the trained policies that are kept, by name"
    description = (
        "List the trained policies that are kept with outlast. Their names are GAME/KIND-SEED. All policy options "
        "take these names, and fetch the file if it is not there. wins: the share of 320 games that it wins against "
        "`scripted`; a draw counts as half."
    )
    examples = [
        ("models", "every name, with how it was trained"),
        ("evaluate teams_3 teams_3/fast-0 scripted", "two policies, of which one is a model"),
    ]
    commands.add_parser("models", help=text, description=description, examples=examples, run=listed)


def listed(options: argparse.Namespace) -> int:
    """Print a line for each model."""
    rows = []
    for each in models().values():
        numbers = f"{each.steps:>11,}", f"{each.wins:.3f}", f"{each.size:>7,}"
        rows.append((each.preset, str(each.seed), *numbers, each.sha256[:SHORT], each.name))
    print(text_table(rows, HEADS))  # as wide as the names of games are
    return 0
