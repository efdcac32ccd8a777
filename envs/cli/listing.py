"""outlast variants: what there is."""

import argparse
from typing import Any

from ..scenarios.ablations import ABLATIONS
from ..scenarios.variants import ALIASES, VARIANTS


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the paper's variants and ablations"
    description = "List the games by name: the paper's variants, and the ablations that may follow a name with a plus."
    examples = [("variants", "every name, and what the game is")]
    commands.add_parser("variants", help=text, description=description, examples=examples).set_defaults(run=variants)


def variants(options: argparse.Namespace) -> int:
    """A line for each of the paper's variants, and for each ablation."""
    for alias, name in ALIASES.items():
        print(f"{name:<9} {alias:<14} {VARIANTS[name].about}")
    print("\nablations, each of which removes a flaw that the paper found, as in teams_2+health_cap+steering:")
    for name, ablation in ABLATIONS.items():
        print(f"+{name:<11} {f'flaw {ablation.flaw}':<11} {ablation.about}")
    return 0
