"""outlast paper: the paper's experiments; what trains and draws them, training/research, is in the repository only."""

import argparse
from typing import Any

from ..base.errors import TrainingError

TEXT = "train, measure and draw the paper's experiments and more"
MISSING = (
    "what repeats the paper is not in the installed package: clone the repository, and install that, as by "
    "`pip install -e '.[train,plot,video]'` in it"
)


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    try:
        from ..research import command
    except ModuleNotFoundError as error:
        if error.name != f"{__package__.rpartition('.')[0]}.research":
            raise
        absent = commands.add_parser("paper", help=TEXT, description=f"Not here: {MISSING}.", examples=[])
        absent.set_defaults(run=_refuse)
    else:
        command.add(commands, TEXT)


def _refuse(options: argparse.Namespace) -> int:
    raise TrainingError(MISSING)
