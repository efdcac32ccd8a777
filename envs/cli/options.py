"""What the options of several commands mean."""

import argparse
import contextlib
from collections.abc import Callable
from typing import Any

from ..core.make import make_vec
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError
from ..rollout.policies import POLICIES, Policy
from ..scenarios.scenario import Scenario
from ..scenarios.variants import variant

SAVED = ".zip"  # what a saved policy's file ends in


def add_scenario(command: argparse.ArgumentParser, several: bool = False) -> None:
    """VARIANT, or several, and --set; `scenario` reads them."""
    command.add_argument("variant", nargs="+" if several else None, help="see `outlast variants`")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NUMBER=VALUE",
        help="change a number: n_agents=10, zone_radii=8,4",
    )


def scenario(options: argparse.Namespace, name: str = "") -> Scenario:
    """The scenario that the options name; of several, the one of that name. Raises ScenarioError."""
    asked = variant(name or options.variant)
    return asked.replace(**dict(_assignment(text, asked.numbers()) for text in options.set))


def add_policy(command: argparse.ArgumentParser) -> None:
    """--policy and --seed; `cast` reads them."""
    command.add_argument(
        "--policy",
        type=policy,
        default="random",
        help=f"{', '.join(POLICIES)}, or what `outlast train` saved, FILE.zip",
    )
    command.add_argument("--seed", type=seed, default=0, help="same seed, same episodes (default 0)")


def policy(text: str) -> str:
    """The name of a policy, or the path of a saved one."""
    if text not in POLICIES and not text.endswith(SAVED):
        raise argparse.ArgumentTypeError(f"{text}: {', '.join(POLICIES)} or a saved policy, FILE{SAVED}, is needed")
    return text


def cast(options: argparse.Namespace) -> tuple[Scenario, Callable[[SurvivalVectorEnv, int], Policy]]:
    """The scenario that the options name, and what makes the policy for it: see POLICIES.

    Raises ScenarioError, UsageError.
    """
    asked = scenario(options)
    if options.policy in POLICIES:
        return asked, POLICIES[options.policy]
    fitting, player = saved(options.policy, asked, options.seed)
    return fitting, lambda env, seed: player


def saved(path: str, asked: Scenario, seed: int) -> tuple[Scenario, Policy]:
    """The scenario in which agents are told what that saved policy was trained with, and the policy.

    Raises UsageError if it cannot play there, or if there is no PyTorch.
    """
    import outlast  # here: the package knows of training, envs do not

    try:
        player = outlast.load_policy(path, seed)
    except ModuleNotFoundError as error:
        raise UsageError(f"{path} needs {error.name}: pip install 'outlast[train]'") from error
    fitting = player.scenario(asked)
    with contextlib.closing(make_vec(fitting, 1, seed=seed)) as env:
        player.check(env)
    return fitting, player


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


def _assignment(text: str, numbers: dict[str, Any]) -> tuple[str, Any]:
    """The name and the value of NUMBER=VALUE; where `numbers` has several for it, they stand between commas."""
    name, _, value = text.partition("=")
    if isinstance(numbers.get(name), tuple):
        return name, tuple(_value(part) for part in value.strip("()[]").split(","))
    return name, _value(value)


def _value(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
