"""What the options of several commands mean."""

import argparse

from ..policies import POLICIES
from ..scenario import Scenario
from ..variants import variant


def add_scenario(command: argparse.ArgumentParser) -> None:
    """VARIANT and --set; `scenario` reads them."""
    command.add_argument("variant", help="see `outlast variants`")
    command.add_argument(
        "--set", action="append", default=[], metavar="NUMBER=VALUE", help="change a number: n_agents=10"
    )


def scenario(options: argparse.Namespace) -> Scenario:
    """The scenario that the options name. Raises ScenarioError."""
    return variant(options.variant).replace(**dict(_assignment(text) for text in options.set))


def add_policy(command: argparse.ArgumentParser) -> None:
    """--policy and --seed."""
    command.add_argument("--policy", choices=sorted(POLICIES), default="random")
    command.add_argument("--seed", type=seed, default=0, help="same seed, same episodes (default 0)")


def positive(text: str) -> int:
    """An integer of at least 1."""
    return _at_least(1, text)


def seed(text: str) -> int:
    """An integer of at least 0."""
    return _at_least(0, text)


def _at_least(least: int, text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"{text}: an integer of at least {least} is needed")
    return value


def _assignment(text: str) -> tuple[str, object]:
    name, _, value = text.partition("=")
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, {"true": True, "false": False}.get(value.lower(), value)
