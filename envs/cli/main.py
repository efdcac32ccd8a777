"""The command line. Its commands are the files beside this one, and what other packages add: see PLUGINS."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import entry_points
from typing import Any

from outlast.ecs.kernels.errors import OutlastError

from ..storage.interrupts import children_awaited, save_requests, stops_as_ctrl_c
from . import check, completion, frames, layout, listing, models, new, numbers, play, replay, rollout, schedule
from .grammar import Parser, overview
from .options import SIGNALLED, STOPPED, check_files, messages_shown, printable, save_scenario
from .streams import standard_streams

COMMANDS = (listing, numbers, new, layout, schedule, check, rollout, frames, play, replay, models, completion)
PLUGINS = "outlast.commands"  # entry points of this group are modules like those beside this one; training has one


def main(arguments: Sequence[str] | None = None, made: Callable[[], Parser] | None = None) -> int:
    """Run a command of `outlast`, or of another program that `program` makes; returns the exit status.

    Errors of use are one line on stderr and status 2. Ctrl-C is 130, SIGTERM 143, SIGHUP 129.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # for PyTorch, which is not loaded yet: its threads wait asleep
    with standard_streams(), children_awaited(), save_requests(), stops_as_ctrl_c() as came:
        status = _run(arguments, made or parser)
    return SIGNALLED + came[0] if status == STOPPED and came else status


def _run(arguments: Sequence[str] | None, made: Callable[[], Parser]) -> int:
    """Run a command, and have what it printed written before Python ends; the exit status."""
    try:
        try:
            return _command(arguments, made)
        finally:  # also after --help, which exits
            sys.stdout.flush()
    except OSError as error:  # a full disk
        return _refused_by_system(error)


def _command(arguments: Sequence[str] | None, made: Callable[[], Parser]) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    options = made().parse_args(words if words and words != ["--"] else ["--help"])
    try:
        with messages_shown():
            check_files(options)
            status = int(options.run(options))
            save_scenario(options)
            return status
    except OutlastError as error:  # a mistake in use: no traceback
        return _refused(str(error))
    except MemoryError as error:
        return _refused(f"there is not enough memory, take fewer --worlds: {error}")
    except OSError as error:
        return _refused_by_system(error)
    except KeyboardInterrupt:  # for commands without a report of their progress
        print("stopped", file=sys.stderr)
        return STOPPED


def _refused_by_system(error: OSError) -> int:
    where = f"{printable(os.fsdecode(error.filename))}: " if isinstance(error.filename, (str, bytes)) else ""
    return _refused(f"{where}{error.strerror or error}")


def _refused(text: str) -> int:
    print(f"outlast: {text}", file=sys.stderr)
    return 2


def parser() -> Parser:
    """Return the grammar of `outlast`."""
    import outlast  # here, as the package imports the environments

    added = (plugin.load() for plugin in entry_points(group=PLUGINS))
    top = program("outlast", "Multi-agent survival worlds, thousands at a time.", (*COMMANDS, *added))
    top.add_argument("--version", action="version", version=f"outlast {outlast.__version__}", help="print the version")
    return top


def program(name: str, description: str, modules: Iterable[Any]) -> Parser:
    """Return the grammar of a program whose commands are these modules."""
    top = Parser(prog=name, description=description)
    commands: Any = top.add_subparsers(metavar="COMMAND", help=argparse.SUPPRESS)
    commands.top = top
    for command in modules:
        command.add(commands)
    text = "show all commands, or how one of them is used"
    examples = [("help", "all commands"), (f"help {[*commands.choices][-1]}", "the options of one command")]
    asked = commands.add_parser(
        "help", help=text, description="Show all commands, or how one of them is used.", examples=examples
    )
    known = list(commands.choices)
    text = "name of the command (default: a short list of all commands)"
    asked.add_argument("command", nargs="?", choices=known, metavar="COMMAND", help=text)
    top.epilog = overview(name, commands)
    return top


if __name__ == "__main__":
    sys.exit(main())
