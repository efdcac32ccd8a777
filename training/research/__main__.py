"""python -m outlast.training.research: train the paper's experiments, or compare runs with the paper."""

import sys
from collections.abc import Sequence

from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.main import main as run
from outlast.envs.cli.main import program

from . import compare, hide_and_seek, long_run, reproduce


def parser() -> Parser:
    """Return the grammar of this program."""
    commands = (module.add for module in (reproduce, compare, hide_and_seek, long_run))
    return program(f"python -m {__package__}", "Repeat and continue the papers of docs/paper.md.", commands)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Return the exit status."""
    return run(arguments, parser)


if __name__ == "__main__":
    sys.exit(main())
