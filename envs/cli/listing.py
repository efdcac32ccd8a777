"""outlast variants: what there is."""

import argparse
import logging
from typing import Any

from ..errors import ScenarioError
from ..scenarios.ablations import ABLATIONS
from ..scenarios.plugins import installed, package, scenario_of_package
from ..scenarios.variants import ALIASES, VARIANTS

LOGGER = logging.getLogger(__name__)


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the paper's variants, installed games, and ablations"
    description = (
        "List the games by name: the paper's variants, the scenarios of installed packages, and the ablations, changes "
        "that can be appended to a name, as in ffa_2+steering."
    )
    examples = [("variants", "every name, with what the game is")]
    command = commands.add_parser("variants", help=text, description=description, examples=examples)
    command.set_defaults(run=variants)


def variants(options: argparse.Namespace) -> int:
    """A line for each of the paper's variants, for each scenario of an installed package, and for each ablation."""
    for alias, name in ALIASES.items():
        print(f"{name:<9} {alias:<14} {VARIANTS[name].about}")
    _list_installed()
    print("\nablations, each of which removes a flaw that the paper found, as in teams_2+health_cap+steering:")
    for name, ablation in ABLATIONS.items():
        print(f"+{name:<11} {f'flaw {ablation.flaw}':<11} {ablation.about}")
    return 0


def _list_installed() -> None:
    """A line for each scenario of an installed package, and a warning for each that cannot be imported."""
    rows = []
    for name, entry in installed().items():
        try:
            rows.append((name, package(entry), scenario_of_package(entry).about))
        except ScenarioError as error:
            LOGGER.warning("%s", error)
    if rows:
        first, second = (max(9, *(len(row[k]) for row in rows)) for k in (0, 1))
        print("\nscenarios of installed packages:")
        for name, offering, about in rows:
            print(f"{name:<{first}} {offering:<{max(second, 14)}} {about}".rstrip())
