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
    text = "list the paper's variants, installed packages' scenarios, and ablations"
    commands.add_parser("variants", help=text).set_defaults(run=variants)


def variants(options: argparse.Namespace) -> int:
    """A line for each of the paper's variants, for each scenario of an installed package, and for each ablation."""
    for alias, name in ALIASES.items():
        print(f"{name:<9} {alias:<14} {VARIANTS[name].about}")
    if installed():
        print("\nscenarios of installed packages:")
    for name, entry in installed().items():
        try:
            print(f"{name:<9} {package(entry):<14} {scenario_of_package(entry).about}".rstrip())
        except ScenarioError as error:
            LOGGER.warning("%s", error)
    print("\nablations, each of which removes a flaw that the paper found, as in teams_2+health_cap+steering:")
    for name, ablation in ABLATIONS.items():
        print(f"+{name:<11} {f'flaw {ablation.flaw}':<11} {ablation.about}")
    return 0
