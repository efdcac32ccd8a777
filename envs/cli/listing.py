"""outlast variants: what there is."""

import argparse
import logging
from typing import Any

from ..errors import ScenarioError
from ..scenarios.imports import installed, package, scenario_of_package
from ..scenarios.variants import ABLATIONS, ALIASES, VARIANTS
from ..text_table import terminal_width, text_table

LOGGER = logging.getLogger(__name__)


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "list the paper's variants, installed games, and ablations"
    description = (
        "List the games by name: the paper's variants, the scenarios of installed packages, and the ablations, changes "
        "that can be appended to a name, as in ffa_2+steering."
    )
    examples = [("variants", "every name, with what the game is")]
    commands.add_parser("variants", help=text, description=description, examples=examples, run=variants)


def variants(options: argparse.Namespace) -> int:
    """List the paper's variants, the scenarios of installed packages and the ablations, a line for each."""
    width = terminal_width()
    print(text_table([(name, alias, VARIANTS[name].about) for alias, name in ALIASES.items()], width=width))
    _list_installed(width)
    print("\nablations, which remove flaws that the paper found, as in teams_2+health_cap:")
    ablations = [(f"+{name}", f"flaw {ablation.flaw}", ablation.about) for name, ablation in ABLATIONS.items()]
    print(text_table(ablations, width=width))
    return 0


def _list_installed(width: int | None) -> None:
    """List the scenarios of installed packages, and warn of those that cannot be imported."""
    rows = []
    for name, entry in installed().items():
        try:
            rows.append((name, package(entry), scenario_of_package(entry).about))
        except ScenarioError as error:
            LOGGER.warning("%s", error)
    if rows:
        print("\nscenarios of installed packages:")
        print(text_table(rows, width=width))
