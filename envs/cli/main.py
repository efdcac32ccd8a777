"""The command line. Its commands are the files beside this one, and what other packages add: see PLUGINS."""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points

from outlast.ecs import EngineError

from ..errors import (
    ClusterError,
    EndlessError,
    FaultError,
    FilmError,
    PageError,
    PlayError,
    RecordingError,
    ScenarioError,
    StateError,
    UsageError,
)
from . import frames, layout, listing, play, replay, rollout, schedule
from .options import messages_shown

COMMANDS = (rollout, replay, play, frames, layout, listing, schedule)
# Reported in one line, without a traceback.
MISTAKES = (
    *(ScenarioError, EngineError, EndlessError, ClusterError, FaultError, FilmError, PageError),
    *(PlayError, RecordingError, StateError, UsageError),
)
PLUGINS = "outlast.commands"  # entry points of this group are modules like those beside this one; training has one


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status. Errors of use are one line on stderr and status 2; Ctrl-C is 130."""
    options = parser().parse_args(arguments)
    try:
        with messages_shown():
            return int(options.run(options))
    except MISTAKES as error:
        print(f"outlast: {error}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"outlast: there is not enough memory, take fewer --worlds: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:  # where a command has nothing to say of what it did so far
        print("stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in `outlast schedule ffa_1 | head`
        return 0


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    import outlast  # here, as the package imports the environments

    top = argparse.ArgumentParser(prog="outlast", description="Multi-agent survival worlds, thousands at a time.")
    top.add_argument("--version", action="version", version=f"outlast {outlast.__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for command in (*COMMANDS, *(plugin.load() for plugin in entry_points(group=PLUGINS))):
        command.add(commands)
    return top


if __name__ == "__main__":
    sys.exit(main())
