"""Options of several commands."""

import argparse
import contextlib
import functools
import logging
import os
import signal
from collections.abc import Callable, Collection, Iterator, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, TextIO

from outlast.ecs import NumberError

from ..api.options import GAME, OUTPUT, Option, default_of, flag_of, help_of, options_of
from ..errors import RecordingError, ScenarioError, UsageError
from ..progress import above_bars
from ..rollout.lineup import checked_entries, parse_lineup
from ..scenarios.derivation import by_full_name
from ..scenarios.floor_plan import LAYOUT, named_layout
from ..scenarios.parse import distribution, mechanic, module_of, resolve, typed, with_roles
from ..scenarios.scenario import Scenario
from ..storage.inputs import read_text
from ..storage.outputs import check_file, written_to
from .grammar import Parser

MAX_SEED = 2**64 - 1
VARIANT = "a game from `outlast variants`, or one of your own: FILE.json, FILE.py:NAME or package.module:NAME"
MAX_COUNT = 10**12  # of worlds, steps, frames: more would take years, or memory that no machine has
SIGNALLED = 128  # beside the number of the signal that ended a process: its exit status
STDOUT = "-"  # as the name of a file
STOPPED = SIGNALLED + signal.SIGINT
READ = ("file", "beside", "layout")  # options and arguments that may name files to be read


class Output(str):
    """The path of a file or folder that a command writes."""

    check: Callable[[str], object]  # raises an error if the path cannot be written


def output(check: Callable[[str], object]) -> Callable[[str], Output]:
    """Return the type of an option that names an Output."""

    def parse(text: str) -> Output:
        if text == STDOUT:
            raise argparse.ArgumentTypeError("the name of a file is needed: only --json - writes to standard output")
        found = Output(path(text))
        found.check = check
        return found

    return parse


def check_files(options: argparse.Namespace) -> None:
    """Check everything that a command is going to write, before it does anything.

    Raises OutlastError: one cannot be written, or two options name one file, of which one is to be written.
    """
    found: dict[str, str] = {}
    outputs = {name: given for name, given in vars(options).items() if isinstance(given, Output)}
    read = {name: getattr(options, name) for name in READ if isinstance(getattr(options, name, None), str)}
    for name, given in {**read, **outputs}.items():
        flag = f"--{name.replace('_', '-')}" if name in outputs or name == "beside" else name.upper()
        other = found.setdefault(os.path.realpath(given), flag)
        if other != flag and name in outputs:
            raise UsageError(f"{other} and {flag} are both {printable(given)}: give another name for one")
    for each in outputs.values():
        each.check(each)


def add_scenario(command: Parser, several: bool = False) -> None:
    """Add VARIANT, or several, and what changes it; `scenario` reads them."""
    game = command.group(GAME)
    game.add_argument("variant", nargs="+" if several else None, metavar="VARIANT", help=VARIANT)
    game.add_argument("--layout", type=path, metavar="LAYOUT", help=f"add walls inside the room: {LAYOUT}")
    add_changes(command)


def add_changes(command: Parser) -> None:
    """Add the options that change a game."""
    command = command.group(GAME)
    text = "change a number of the game, such as n_agents=10 or safe_zone_radii=8,4; `outlast numbers VARIANT` lists "
    text += "them (can be repeated)"
    command.add_argument("--set", action="append", default=[], metavar="NUMBER=VALUE", help=text)
    text = "draw a number at random for every episode of every world: 'melee_damage=integers(5, 20)' (20 included), "
    text += "'motors_turn=uniform(0.01, 0.02)' or 'safe_zone_damage=choice(1, 5)' (can be repeated)"
    command.add_argument("--vary", action="append", default=[], metavar="NUMBER=DRAWN", help=text)
    text = "leave out a mechanic, such as safe_zone (can be repeated)"
    command.add_argument("--without", action="append", default=[], metavar="MECHANIC", help=text)
    text = "add a mechanic of outlast, as in 'DropLast(offset=2.0)', or one of your own, FILE.py:NAME (can be repeated)"
    command.add_argument("--with", action="append", default=[], metavar="MECHANIC", help=text)
    add_import(command, "--with or the FILE.json given as VARIANT uses")
    text = "divide the agents into roles that have numbers of their own, by this file (format: docs/levels.md)"
    command.add_argument("--roles", type=path, metavar="FILE.json", help=text)
    text = "write the changed game to this file, which can be given as VARIANT"
    check = functools.partial(check_file, what="scenarios", error=ScenarioError, endings=(".json",))
    command.add_argument("--save-scenario", type=output(check), metavar="FILE.json", help=text)


def add_import(command: Any, named: str) -> None:
    """Add --import, for mechanics that something names; `import_files` imports them."""
    text = f"Python file or module to import first, because {named} mechanics in it (can be repeated)"
    command.add_argument("--import", action="append", default=[], metavar="FILE.py", help=text)


def import_files(options: argparse.Namespace) -> None:
    """Import what --import names. Raises ScenarioError."""
    for place in getattr(options, "import"):
        module_of(place)


def scenario(options: argparse.Namespace, name: str = "") -> Scenario:
    """Return the scenario that the options name; of several, the one of that name.

    Raises ScenarioError, NumberError.
    """
    import_files(options)
    asked = resolve(name or options.variant)
    walls = () if options.layout is None else named_layout(options.layout)
    more = [(f"--with {text}", *mechanic(text)) for text in getattr(options, "with")]
    asked = asked.with_(*walls).with_(*(module for _, module, _ in more)).without(*options.without)
    if any(module not in asked.modules for module in walls):
        raise ScenarioError(f"--layout {options.layout}: --with or --without takes it out again; use one of them")
    if gone := [option for option, module, _ in more if type(module) not in map(type, asked.modules)]:
        raise ScenarioError(f"{gone[0]}: --without takes it out again; use one of them")
    if options.roles is not None:
        asked = with_roles(asked, options.roles)
    given = by_full_name(asked.find_number, [_parts("--set", text) for text in options.set])
    fixed = {name: "--with" for _, _, names in more for name in names}
    if twice := sorted(fixed.keys() & given.keys()):
        raise ScenarioError(f"--set {twice[0]}: --with has it, too; use one of them")
    now = asked.numbers()
    asked = asked.replace(**{name: typed(text, now[name]) for name, text in given.items()})
    asked = _varied(asked, fixed | dict.fromkeys(given, "--set"), options)
    if options.save_scenario is not None:
        _check_save(asked, options)
        options.changed_scenario = asked
    return asked


def _check_save(asked: Scenario, options: argparse.Namespace) -> None:
    """Raise ScenarioError if --save-scenario would replace another scenario."""
    path = Path(options.save_scenario)
    if isinstance(options.variant, list) and len(options.variant) > 1:
        raise ScenarioError(f"--save-scenario writes one scenario, and {len(options.variant)} are named")
    if path.exists():
        with contextlib.suppress(ValueError):  # it is too large, or not text
            if read_text(path) == asked.to_json():
                return
        raise ScenarioError(f"--save-scenario: {path} exists, and holds something else: choose another name")


def save_scenario(options: argparse.Namespace) -> None:
    """Write what --save-scenario asks for, behind all that a command may be refused for. Raises ScenarioError."""
    if (asked := getattr(options, "changed_scenario", None)) is not None:
        _check_save(asked, options)
        with written_to(f"--save-scenario: {options.save_scenario}", ScenarioError):
            asked.save(options.save_scenario)


def add_options(
    command: Parser, kind: Any, only: Collection[str] = (), before: str = "", **more: Mapping[str, Any]
) -> None:
    """Add the flags of the options that a dataclass declares; `given_options` reads them.

    Args:
        command: The parser of a command.
        kind: The dataclass.
        only: Names of the options to add; () adds all.
        before: What the help of each one begins with.
        **more: By option, arguments of add_argument that do not follow from what is declared.
    """
    for name, own in options_of(kind).items():
        if (only and name not in only) or not own.group:
            continue
        usual, how = default_of(kind, name), dict[str, Any]()
        if own.many:
            usual, how = [], {"action": "append"}
        elif isinstance(usual, bool):
            how, usual = {"action": "store_true"}, False
        elif own.least is not None:
            most = MAX_COUNT if own.most == Option.most else own.most
            how = {"type": functools.partial(count, least=own.least, most=most)}
        how |= {"choices": own.choices} if own.choices else {}
        how |= {"metavar": own.metavar} if own.metavar else {}
        how |= {"default": usual, "help": before + help_of(kind, name), **PARSED.get(name, {}), **more.get(name, {})}
        command.group(own.group).add_argument(flag_of(name, own), **how)


def given_options(options: argparse.Namespace, kind: Any) -> dict[str, Any]:
    """Return the options of a dataclass that were given, or are as usual, by name; without those that have no flag."""
    flags = {name: flag_of(name, own) for name, own in options_of(kind).items() if own.group}
    found = {name: getattr(options, flag.removeprefix("--").replace("-", "_")) for name, flag in flags.items()}
    return {name: not value if default_of(kind, name) is True else value for name, value in found.items()}


def add_quiet(command: Parser) -> None:
    """Add --quiet."""
    command.group(OUTPUT).add_argument("--quiet", action="store_true", help="show no progress bar")


def _players(text: str, several: bool) -> str | dict[str, float]:
    """Return the name of a policy, or the path of a saved one; of several, the weights by these."""
    try:
        return parse_lineup(text) if several else str(checked_entries([(text, 1)])[0][0])
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


@contextlib.contextmanager
def messages_shown(name: str = "outlast", form: str = "outlast: %(message)s") -> Iterator[None]:
    """Show on stderr, within the block, what the logger and those below it get, except for deaths below it."""
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
    def emit(self, record: logging.LogRecord) -> None:
        with above_bars(self.stream):
            super().emit(record)


def printable(path: str) -> str:
    """Return the path, escaped where it is not UTF-8, which standard output may refuse."""
    return os.fsencode(path).decode(errors="backslashreplace")


def path(text: str) -> str:
    """Return the path of a file or folder; an empty one would be the current folder."""
    if not text:
        raise argparse.ArgumentTypeError("the name of a file or folder is needed, not nothing")
    return text


def count(text: str, least: int = 1, most: int = MAX_COUNT) -> int:
    """Return an integer as people write them: 1000, 1_000, 1e3, 2.5e6. Raises argparse.ArgumentTypeError."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        value = Decimal("nan")
    if not value.is_finite() or value < least or (value <= most and value != value.to_integral_value()):
        raise argparse.ArgumentTypeError(f"{text}: an integer of at least {least} is needed, such as 1000 or 1e6")
    if value > most:
        named = "2**64 - 1" if most == MAX_SEED else f"{most:,}"
        raise argparse.ArgumentTypeError(f"{text}: an integer of at most {named} is needed")
    return int(value)


positive, nonnegative = functools.partial(count, least=1), functools.partial(count, least=0)
seed = functools.partial(count, least=0, most=MAX_SEED)

# how the values of some options are parsed, by their names
PARSED: dict[str, dict[str, Any]] = {
    "seed": {"type": seed},
    "policy": {"type": functools.partial(_players, several=False)},
    "others": {"type": functools.partial(_players, several=True)},
    "record": {"type": output(functools.partial(check_file, what="recordings", error=RecordingError, new=True))},
}


def _varied(asked: Scenario, fixed: Mapping[str, str], options: argparse.Namespace) -> Scenario:
    """Return the scenario with the distributions of --vary. fixed: which option sets a number."""
    parts = [_parts("--vary", text, "'melee_damage=integers(5, 20)'") for text in options.vary]
    drawn = {}
    for name, text in by_full_name(asked.find_number, parts).items():
        if name in fixed:
            raise ScenarioError(f"--vary {name}: {fixed[name]} has it, too; use one of them")
        try:
            drawn[name] = distribution(text)
        except (ScenarioError, NumberError) as error:
            raise type(error)(f"--vary {name}: {error}") from None
    return asked.vary(**drawn) if drawn else asked


def _parts(option: str, text: str, example: str = "n_agents=10") -> tuple[str, str]:
    """Return what is before and behind the sign of an option. Raises ScenarioError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        kind = "VALUE" if option == "--set" else "DRAWN"
        raise ScenarioError(f"{option} {text}: NUMBER={kind} is needed, as in {option} {example}")
    return name, value
