"""Tables of results: printed, and kept as CSV in a folder for each machine."""

import argparse
import csv
import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from outlast.systems import box2d

FOLDER = Path(__file__).parent / "results"


class Table:
    """Rows under named columns; numbers are rounded to four digits."""

    def __init__(self, name: str, *columns: str) -> None:
        self.name, self.columns, self.rows = name, columns, list[list[str]]()

    def add(self, *row: object) -> None:
        """Add one row, in the order of the columns."""
        if len(row) != len(self.columns):
            raise ValueError(f"{len(row)} cells for {len(self.columns)} columns")
        self.rows.append([f"{x:.4g}" if isinstance(x, float) else str(x) for x in row])

    def __str__(self) -> str:
        lines = [list(self.columns), *self.rows]
        widths = [max(len(line[k]) for line in lines) for k in range(len(self.columns))]
        return "\n".join(_line(line, widths) for line in lines)

    def finish(self, machine: str | None, beside: str = "") -> None:
        """Print the table; for a named machine also write it to perf/results/MACHINE/NAME.csv, whole or not at all.

        Args:
            machine: the name of the folder, or None.
            beside: what else was used, beside what `describe` names.
        """
        machine_line = "; ".join(filter(None, (describe(), beside)))
        print(f"{self}\n{machine_line}\n")
        if machine is None:
            return
        path = FOLDER / machine / f"{self.name}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp")
        with temporary.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *self.rows])
        os.replace(temporary, path)
        line = path.with_suffix(".txt") if beside else path.with_name("machine.txt")
        line.write_text(machine_line + "\n")


def machines(name: str) -> list[str]:
    """The machines for which that table is kept."""
    return sorted(path.parent.name for path in FOLDER.glob(f"*/{name}.csv"))


def has(name: str, machine: str) -> bool:
    """Return whether that table of that machine is kept."""
    return machine in machines(name)


def read(name: str, machine: str) -> tuple[list[str], list[dict[str, str]]]:
    """The columns and the rows of a saved table."""
    with (FOLDER / machine / f"{name}.csv").open(newline="") as file:
        table = csv.DictReader(file)
        return list(table.fieldnames or ()), list(table)


def about(name: str, machine: str) -> str:
    """The line about what a saved table was measured on."""
    own = FOLDER / machine / f"{name}.txt"
    return (own if own.exists() else own.with_name("machine.txt")).read_text().strip()


def options(script: str | None) -> argparse.ArgumentParser:
    """The command line of a benchmark: what all have in common."""
    parser = argparse.ArgumentParser(description=script, formatter_class=argparse.RawDescriptionHelpFormatter)
    text = "also keep the numbers, in the folder perf/results/MACHINE"
    parser.add_argument("--save", type=_machine, metavar="MACHINE", help=text)
    return parser


def positive(text: str) -> int:
    """A whole number of at least 1, for command lines."""
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text}: a whole number from 1 is needed")
    return int(text)


def _machine(text: str) -> str:
    """The name of a folder in which tables can be kept; this is checked before anything is measured."""
    place = FOLDER / text
    if place.exists() and not (place.is_dir() and os.access(place, os.W_OK)):
        raise argparse.ArgumentTypeError(f"{place} is no folder that can be written to: give another name")
    return text


def describe() -> str:
    """This machine and what runs on it, in a line."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    versions = f"numpy {version('numpy')}, numba {version('numba')}, Box2D {box2d.VERSION}"
    cpu = names[0] if names else platform.processor()
    return f"{cpu} ({get_host_cpu_name()}), {os.cpu_count()} CPUs; Python {platform.python_version()}, {versions}"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join([cells[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(cells[1:], widths[1:], strict=True))])
