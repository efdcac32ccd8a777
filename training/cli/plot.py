"""outlast plot: curves and end values of runs, compared with each other or with the paper's. Needs no PyTorch."""

import argparse
from pathlib import Path
from typing import Any

from outlast.envs.cli.options import add_options, output

from ..base.errors import TrainingError
from ..base.files import check_out, write_files
from ..plots.comparison import AXES
from ..plots.plot import DRAWN, OUTPUT, PlotOptions, plot
from .paper import MISSING


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("plot runs", "all runs in a folder in one figure, in the folder figures"),
        (
            "plot runs/weak runs/strong --by melee_damage --curves length,wins/scripted",
            "two curves of each, in groups by a number of the game",
        ),
        ("plot runs --paper --out figures/paper", "runs of the paper's variants beside the paper's curves"),
    ]
    description = (
        "Draw the learning curves of runs in one figure, and write a table of their values at the end. Runs that "
        "differ only in their seeds are one group, drawn as their mean and a band."
    )
    text = "draw the learning curves of runs, and tabulate their end values"
    command = commands.add_parser("plot", help=text, description=description, examples=examples)
    text = "folder of a run, a folder with several of these, such as runs, or kept results: all of a folder, or one by "
    text += "its name, such as results/original/ffa_2-original-0"
    command.group(DRAWN).add_argument("runs", nargs="+", type=Path, metavar="RUN", help=text)
    names = {"type": _names}
    add_options(command, PlotOptions, out={"type": output(check_out)}, by=names, curves=names)
    text = "compare runs of the paper's variants with the paper: draw a figure for each variant and preset, and check "
    text += "the paper's claims"
    command.group(DRAWN).add_argument("--paper", action="store_true", help=text)
    text = "with --paper: also write the runs' curves, and newest policies as RUN.safetensors, to this folder"
    command.group(OUTPUT).add_argument("--keep", type=output(check_out), metavar="FOLDER", help=text)
    command.set_defaults(run=run)


def _names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(f"{text}: names are needed, with a comma between two of them")
    return names


def run(options: argparse.Namespace) -> int:
    """Draw; the exit status. Nothing is written if anything is wrong with the runs."""
    options.out, options.keep = Path(options.out), options.keep and Path(options.keep)
    if options.paper:
        return _beside_the_paper(options)
    if options.keep:
        raise TrainingError("--keep is for results beside the paper's: add --paper")
    found = plot(options.runs, options.out, by=options.by, curves=options.curves, x=options.x, form=options.format)
    print(found)
    print("\n".join(map(str, found.files)))
    return 0


def _beside_the_paper(options: argparse.Namespace) -> int:
    if options.by or options.curves or options.x != AXES[0]:
        raise TrainingError("with --paper, the curves and the groups are the paper's: leave out --by, --curves and --x")
    try:
        from ..research.report import figures_and_tables, report
        from ..research.results import files_to_keep, group_runs, load_runs
    except ModuleNotFoundError as error:
        if error.name != f"{__package__.rpartition('.')[0]}.research":
            raise
        raise TrainingError(f"--paper: {MISSING}") from error
    runs = load_runs(options.runs)
    groups = group_runs(runs)
    contents = files_to_keep(runs, options.keep) if options.keep else {}
    contents |= {options.out / name: content for name, content in figures_and_tables(groups, options.format).items()}
    write_files(contents)
    print(report(groups))
    print("\n".join(str(path) for path in contents))
    return 0
