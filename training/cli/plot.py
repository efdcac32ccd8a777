"""outlast plot: the paper's figures from the logs of runs, and a table of their end values. Needs no PyTorch."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from outlast.envs.errors import install

from ..errors import TrainingError
from ..files import write_files
from ..paper.claims import sentences
from ..paper.end_values import csv_table, markdown
from ..paper.results import RunGroup, files_to_keep, group_runs, load_runs

FORMS = ("png", "svg")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("plot", help="figures and a table of runs of `outlast train`, beside the paper's")
    command.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="folder of a run, a kept result, or a folder of such: runs"
    )
    command.add_argument("--out", type=Path, default=Path("figures"), help="folder to write into (default figures)")
    command.add_argument("--format", choices=FORMS, default="png", help="of the figures (default png)")
    command.add_argument("--keep", type=Path, metavar="FOLDER", help="also keep there curves and policies, small")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Draw; the exit status. Nothing is written if anything is wrong with the runs."""
    runs = load_runs(options.runs)
    groups = group_runs(runs)
    contents = files_to_keep(runs, options.keep) if options.keep else {}
    contents |= {options.out / name: content for name, content in figures_and_tables(groups, options.format).items()}
    write_files(contents)
    print(report(groups))
    print("\n".join(str(path) for path in contents))
    return 0


def report(groups: Sequence[RunGroup]) -> str:
    """All tables and the checks of the paper's claims, in Markdown."""
    parts = (part for group in groups for part in (markdown(group), sentences(group)) if part)
    return "\n\n".join(parts) + "\n"


def figures_and_tables(groups: Sequence[RunGroup], form: str) -> dict[str, bytes]:
    """The contents of all files, by name: the figures, and the table in Markdown and CSV."""
    try:
        from ..paper.figures import picture
    except ModuleNotFoundError as error:
        raise TrainingError(f"figures need {error.name}: {install('plot')}") from error
    figures = {f"{group.name}.{form}": picture(group, form) for group in groups}
    return {**figures, "ends.md": report(groups).encode(), "ends.csv": csv_table(groups).encode()}
