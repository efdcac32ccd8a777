"""outlast variants, outlast schedule: what there is."""

import argparse
from typing import Any

from outlast.ecs import Worlds

from ..scenarios.ablations import ABLATIONS
from ..scenarios.variants import ALIASES, VARIANTS, variant


def add(commands: Any) -> None:
    """Add both commands to a parser's commands."""
    commands.add_parser("variants", help="list the paper's variants and ablations").set_defaults(run=variants)
    table = commands.add_parser("schedule", help="print the tick of a variant as a table")
    table.add_argument("variant")
    table.set_defaults(run=schedule)


def variants(options: argparse.Namespace) -> int:
    """A line for each of the paper's variants, and for each ablation."""
    for alias, name in ALIASES.items():
        print(f"{name:<9} {alias:<14} {VARIANTS[name].about}")
    print("\nwith flaws that the paper found in them mended, as in teams_2+health_cap+steering:")
    for name, ablation in ABLATIONS.items():
        print(f"+{name:<11} {f'flaw {ablation.flaw}':<11} {ablation.about}")
    return 0


def schedule(options: argparse.Namespace) -> int:
    """The tick as a table."""
    print(Worlds(variant(options.variant).modules, 1).schedule)
    return 0
