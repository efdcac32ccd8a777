"""Scenarios of installed packages: entry points of the group `outlast.scenarios`, NAME = "package.module:scenario"."""

import functools
import logging
import re
from importlib.metadata import EntryPoint, entry_points

from ..errors import ScenarioError
from .imports import scenario_in
from .scenario import Scenario
from .variants import ALIASES, VARIANTS

GROUP = "outlast.scenarios"
LOGGER = logging.getLogger("outlast")


@functools.cache  # cached, so that each warning is given once
def installed() -> dict[str, EntryPoint]:
    """Return the scenarios of installed packages by name, without importing anything of them.

    A scenario that cannot be used by its name is left out, with a warning that names the package.
    """
    found = dict[str, EntryPoint]()
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, package(entry))):
        if entry.name in VARIANTS or entry.name in ALIASES:
            problem = "that is the name of a variant"
        elif not re.fullmatch(r"[A-Za-z][\w-]*", entry.name):
            problem = "a name has letters, digits, - and _ only"
        elif entry.name in found and found[entry.name].value != entry.value:
            problem = f"{package(found[entry.name])} has one of that name, too"
        else:
            found[entry.name] = entry
            continue
        LOGGER.warning("the scenario '%s' of the package %s is left out: %s", entry.name, package(entry), problem)
    return found


def package(entry: EntryPoint) -> str:
    """Return the name of the package that an entry point belongs to."""
    return entry.dist.name if entry.dist else entry.module


def scenario_of_package(entry: EntryPoint) -> Scenario:
    """Import the scenario of an entry point. Raises a ScenarioError that names the package."""
    try:
        return scenario_in(entry.module, entry.attr, entry.name)
    except ScenarioError as error:
        raise ScenarioError(f"the scenario '{entry.name}' of the package {package(entry)}: {error}") from error
