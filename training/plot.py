"""outlast plot: the paper's figures from the logs of runs, and a table of where they end. Needs no PyTorch."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from outlast.envs.errors import TrainingError
from outlast.envs.storage.atomic_write import atomic_write

from . import keep
from .claims import sentences
from .endtable import markdown, table
from .results import Group, grouped, load

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
    results = load(options.runs)
    groups = grouped(results)
    contents = keep.files(results, options.keep) if options.keep else {}
    contents |= {options.out / name: content for name, content in made(groups, options.format).items()}
    write(contents)
    print(report(groups))
    print("\n".join(str(path) for path in contents))
    return 0


def report(groups: Sequence[Group]) -> str:
    """All tables with what they say of the paper, in Markdown."""
    parts = (part for group in groups for part in (markdown(group), sentences(group)) if part)
    return "\n\n".join(parts) + "\n"


def made(groups: Sequence[Group], form: str) -> dict[str, bytes]:
    """All figures, and the table in both forms, by name of the file."""
    try:
        from .figures import picture
    except ModuleNotFoundError as error:
        raise TrainingError(f"figures need {error.name}: pip install 'outlast[plot]'") from error
    figures = {f"{group.name}.{form}": picture(group, form) for group in groups}
    return {**figures, "ends.md": report(groups).encode(), "ends.csv": table(groups).encode()}


def write(contents: Mapping[Path, bytes]) -> None:
    """Write files, each of them whole or not at all. Raises TrainingError."""
    for path, content in contents.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as place:
                place.write_bytes(content)
        except OSError as error:
            raise TrainingError(f"{path} cannot be written: {error.strerror}") from error
