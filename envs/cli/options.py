"""What the options of several commands mean."""

import argparse
import contextlib
import logging
import os
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TextIO

import numpy as np
from tqdm import tqdm

from ..core.make import make_vec
from ..core.vector_env import SurvivalVectorEnv
from ..errors import ScenarioError, UsageError
from ..rollout.mixture import checked_entries, parse_mixture
from ..rollout.policies import POLICIES, Policy
from ..rollout.saved import SAVED, common_scenario, load_saved
from ..scenarios.floor_plan import LAYOUT, named_layout
from ..scenarios.naming import resolve
from ..scenarios.renamed import NUMBERS
from ..scenarios.scenario import Scenario

MAX_SEED = 2**64 - 1
VARIANT = "name of a game, see `outlast variants`; or one of your own: FILE.py:NAME, package.module:NAME"


def add_scenario(command: argparse.ArgumentParser, several: bool = False) -> None:
    """VARIANT, or several, and --set; `scenario` reads them."""
    command.add_argument("variant", nargs="+" if several else None, help=VARIANT)
    text = "change a number of the game: n_agents=10, safe_zone_radii=8,4 (may be given several times)"
    command.add_argument("--set", action="append", default=[], metavar="NUMBER=VALUE", help=text)
    command.add_argument("--layout", metavar="NAME", help=f"walls inside of the room: {LAYOUT}")


def scenario(options: argparse.Namespace, name: str = "") -> Scenario:
    """The scenario that the options name; of several, the one of that name. Raises ScenarioError."""
    asked = resolve(name or options.variant)
    if options.layout is not None:
        asked = asked.with_(*named_layout(options.layout))
    return asked.replace(**dict(_assignment(text, asked.numbers()) for text in options.set))


def add_policy(command: argparse.ArgumentParser, default: str) -> None:
    """--policy; `scenario_and_policy` reads it."""
    text = f"{', '.join(POLICIES)}, or FILE{SAVED} that `outlast train` saved (default: {default})"
    command.add_argument("--policy", type=policy, default=default, metavar="NAME", help=text)


def add_others(command: argparse.ArgumentParser, default: str | None, text: str) -> None:
    """--others, weights by name or path; `load_policies` reads the names. text: what they do."""
    text += ": policies with weights, as scripted:0.5,FILE.zip:0.5; one of them is drawn for each world and episode"
    given = None if default is None else {default: 1.0}
    command.add_argument(
        "--others", type=mixture, default=given, metavar="NAMES", help=f"{text} (default: {default or 'none'})"
    )


def add_seed(command: argparse.ArgumentParser) -> None:
    """--seed."""
    text = "the same seed gives the same episodes (default: 0)"
    command.add_argument("--seed", type=seed, default=0, metavar="N", help=text)


def add_number(command: Any, option: str, default: Any, text: str, least: int = 1, **more: Any) -> None:
    """An option for an integer. default: the number, or words for what it is without the option."""
    kind, number = positive if least else nonnegative, default if isinstance(default, int) else None
    command.add_argument(option, type=kind, default=number, metavar="N", help=f"{text} (default: {default})", **more)


def add_page(command: argparse.ArgumentParser) -> None:
    """--port and --no-browser, of commands that serve a page; `announce` reads the latter."""
    text = "port of 127.0.0.1 (default: 0, one that is free)"
    command.add_argument("--port", type=port, default=0, metavar="PORT", help=text)
    command.add_argument("--no-browser", action="store_true", help="print the address and open no browser")


def announce(options: argparse.Namespace, text: str, address: str) -> None:
    """Print what is to be seen at an address, and open it in a browser unless that is not wanted."""
    print(text, flush=True)
    if not options.no_browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some wait for their browser


def add_common(command: argparse.ArgumentParser, *options: str) -> None:
    """Those of --threads, --record and --quiet that are named."""
    if "--threads" in options:
        add_number(command, "--threads", 1, "threads that share the worlds")
    if "--record" in options:
        command.add_argument(
            "--record", metavar="FILE", help="record everything in a new file, for `outlast replay FILE`"
        )
    if "--quiet" in options:
        command.add_argument("--quiet", action="store_true", help="show no progress bar")


def policy(text: str) -> str:
    """The name of a policy, or the path of a saved one."""
    try:
        checked_entries([(text, 1)])
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def mixture(text: str) -> dict[str, float]:
    """Weights by name of a policy, or by path of a saved one."""
    try:
        return parse_mixture(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def scenario_and_policy(options: argparse.Namespace) -> tuple[Scenario, Callable[[SurvivalVectorEnv, int], Policy]]:
    """The scenario that the options name, and what makes the policy for it: see POLICIES.

    Raises ScenarioError, UsageError.
    """
    fitting, (chosen,) = load_policies([options.policy], scenario(options), options.seed)
    return fitting, maker(chosen)


def maker(chosen: str | Policy) -> Callable[[SurvivalVectorEnv, int], Policy]:
    """What makes the policy of that name, or is done with that policy: see POLICIES."""
    return POLICIES[chosen] if isinstance(chosen, str) else lambda env, seed: chosen


def load_policies(names: Sequence[str], asked: Scenario, seed: int) -> tuple[Scenario, list[str | Policy]]:
    """Load what is saved, and find the scenario with observations that all can play with.

    Args:
        names: Of policies, and paths of saved ones.
        asked: The scenario.
        seed: Of all policies; each draws numbers of its own.

    Returns:
        The scenario, and for each name itself, or the policy in that file.

    Raises:
        UsageError: One cannot play there, or there is no PyTorch.
    """
    seeds = [seed, *(int(np.random.SeedSequence([seed, k]).generate_state(1)[0]) for k in range(1, len(names)))]
    chosen = [name if name in POLICIES else load_saved(name, own) for name, own in zip(names, seeds, strict=True)]
    players = [policy for policy in chosen if not isinstance(policy, str)]
    fitting = common_scenario(asked, players)
    if players:
        with contextlib.closing(make_vec(fitting, 1, seed=seed)) as env:
            for player in players:
                player.check(env)
    return fitting, chosen


@contextlib.contextmanager
def messages_shown(name: str = "outlast", form: str = "outlast: %(message)s") -> Iterator[None]:
    """Meanwhile show on stderr what the logger of that name and those below it get, except for deaths below it."""
    logger, handler = logging.getLogger(name), _BesideBars()
    level = logger.level
    handler.setFormatter(logging.Formatter(form))
    handler.addFilter(lambda record: record.name == name or record.name != "outlast.deaths")
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


class _BesideBars(logging.StreamHandler[TextIO]):
    """Writes messages above progress bars, which would else be written over."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a message."""
        with tqdm.external_write_mode(file=self.stream):
            super().emit(record)


def printable(path: str) -> str:
    """The path, escaped where it is no UTF-8, which standard output may refuse."""
    return os.fsencode(path).decode(errors="backslashreplace")


def positive(text: str) -> int:
    """An integer of at least 1."""
    return _integer(text, 1)


def port(text: str) -> int:
    """A port, or 0."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text}: a port is needed, 1 to 65535, or 0 for a free one")
    return int(text)


def nonnegative(text: str) -> int:
    """An integer of at least 0."""
    return _integer(text, 0)


def seed(text: str) -> int:
    """An integer from 0 to 2**64 - 1."""
    value = _integer(text, 0)
    if value > MAX_SEED:
        raise argparse.ArgumentTypeError(f"{text}: an integer of at most 2**64 - 1 is needed")
    return value


def _integer(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"{text}: an integer of at least {least} is needed")
    return value


def _assignment(text: str, numbers: dict[str, Any]) -> tuple[str, Any]:
    """The name and the value of NUMBER=VALUE; where `numbers` has several for it, they stand between commas."""
    name, equals, value = text.partition("=")
    if not equals:
        raise ScenarioError(f"--set {text}: NUMBER=VALUE is needed, as in --set n_agents=10")
    if isinstance(numbers.get(NUMBERS.get(name, name)), tuple):
        return name, tuple(_value(part) for part in value.strip("()[]").split(","))
    return name, _value(value)


def _value(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
