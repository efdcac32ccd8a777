"""compare: runs of the paper's variants beside the paper's curves, and its claims."""

import argparse
from pathlib import Path
from typing import Any

from outlast.envs.cli.options import output
from outlast.envs.core.options import OUTPUT

from ..base.files import check_out, write_files
from ..plots.plot import DRAWN, FORMS
from .report import figures_and_tables, report
from .results import files_to_keep, group_runs, load_runs


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "compare runs of the paper's variants with the paper"
    description = "Draw a figure for each variant and preset, beside the paper's curves, and check the paper's claims."
    examples = [("compare runs --out figures/paper", "all runs in a folder")]
    command = commands.add_parser("compare", help=text, description=description, examples=examples)
    text = "folder of a run, or a folder with several of these, or with kept results"
    command.group(DRAWN).add_argument("runs", nargs="+", type=Path, metavar="RUN", help=text)
    group = command.group(OUTPUT)
    text = "folder for figures and tables (default figures)"
    group.add_argument("--out", type=output(check_out), default="figures", metavar="FOLDER", help=text)
    group.add_argument("--format", choices=FORMS, default=FORMS[0], help=f"format of the figures (default {FORMS[0]})")
    text = "also write the runs' curves, and newest policies as RUN.safetensors, to this folder"
    group.add_argument("--keep", type=output(check_out), metavar="FOLDER", help=text)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Draw. Return the exit status. Writes nothing if a run is invalid."""
    runs = load_runs(options.runs)
    groups = group_runs(runs)
    contents = files_to_keep(runs, Path(options.keep)) if options.keep else {}
    drawn = figures_and_tables(groups, options.format)
    contents |= {Path(options.out) / name: content for name, content in drawn.items()}
    write_files(contents)
    print(report(groups), *contents, sep="\n")
    return 0
