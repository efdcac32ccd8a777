"""outlast plot: curves and end values of runs, compared with each other. Does not need PyTorch."""

import argparse
from pathlib import Path
from typing import Any

from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import add_options, given_options, output

from ..base.files import check_out
from ..plots.plot import DRAWN, PlotOptions, plot


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "plot", run)
    text = "folder of a run, a folder with several of these, such as runs, or kept results: all of a folder, or one by "
    text += "its name, such as results/original/ffa_2-original-0"
    command.group(DRAWN).add_argument("runs", nargs="+", type=Path, metavar="RUN", help=text)
    names = {"type": _names}
    add_options(command, PlotOptions, out={"type": output(check_out)}, by=names, curves=names)


def _names(text: str) -> tuple[str, ...]:
    """Return names between commas."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(f"{text}: must be names separated by commas")
    return names


def run(options: argparse.Namespace) -> None:
    """Draw the learning curves of runs, and tabulate their end values.

    Draw the learning curves of runs in one figure, and write a table of their values at the end. Runs that differ only
    in their seeds are one group, drawn as their mean and a band.

    Examples:
        plot runs  # all runs in a folder in one figure, in the folder figures
        plot runs/weak runs/strong --by melee_damage --curves length,wins/scripted
            # two curves of each, in groups by a number of the game
    """
    found = plot(options.runs, **given_options(options, PlotOptions))
    print(found, *found.files, sep="\n")
