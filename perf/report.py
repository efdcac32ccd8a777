"""Write the results of a machine into the tables of the docs, and draw a plot.

    python -m perf.report MACHINE

It needs matplotlib: pip install 'outlast[plot]'. The pages are performance.md,
training.md and peers.md in docs. A table stands between the comments
<!-- table NAME of MACHINE: column, ... --> and <!-- end -->, and is replaced.
NAME is a file of perf/results/MACHINE, and the named columns are shown, or all
of them if none is named. A table that MACHINE has results for becomes that of
MACHINE; all others stay those of the machine that they name. The line about the
machine of table NAME is written between <!-- machine of NAME --> and
<!-- end -->. Between <!-- ratios --> and <!-- end -->, a table says how many
times faster than the original outlast was on each machine.
"""

import argparse
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from perf.table import FOLDER, about, has, machines, read

ROOT = Path(__file__).parent.parent
DOCUMENTS = tuple(ROOT / "docs" / f"{page}.md" for page in ("performance", "training", "peers"))
TABLE = re.compile(
    r"<!-- table (?P<name>[\w-]+) of (?P<machine>[\w-]+)(?P<columns>: [^>]*?)? -->\n.*?<!-- end -->", re.DOTALL
)
MACHINE = re.compile(r"(<!-- machine of (?P<name>[\w-]+) -->).*?(<!-- end -->)", re.DOTALL)
RATIOS = re.compile(r"(<!-- ratios -->\n).*?(<!-- end -->)", re.DOTALL)
FIGURE = ROOT / "docs" / "performance.png"


def main() -> None:
    """Rewrite the documents and draw the plot."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("machine", help=f"whose results: {', '.join(sorted(p.name for p in FOLDER.iterdir()))}")
    machine = options.parse_args().machine
    for document in DOCUMENTS:
        document.write_text(filled(document.read_text(), machine))
        print(document.relative_to(ROOT))
    if has("worlds", machine):
        draw(machine)
        print(FIGURE.relative_to(ROOT))


def filled(text: str, machine: str | None = None) -> str:
    """The text of a document with its tables as they are kept, those of `machine` where it has them."""
    shown: dict[str, str] = {}  # the machine of each table

    def table(match: re.Match[str]) -> str:
        name, own = match["name"], machine if machine and has(match["name"], machine) else match["machine"]
        shown[name] = own
        header, rows = read(name, own)
        columns = match["columns"].removeprefix(": ").split(", ") if match["columns"] else header
        lines = markdown(columns, ([row[column] for column in columns] for row in rows))
        return f"<!-- table {name} of {own}{match['columns'] or ''} -->\n{lines}<!-- end -->"

    def line(match: re.Match[str]) -> str:
        return match[1] + about(match["name"], shown[match["name"]]) + match[3]

    text = RATIOS.sub(lambda match: match[1] + ratios() + match[2], TABLE.sub(table, text))
    return MACHINE.sub(line, text)


def ratios() -> str:
    """Return how many times faster than the original outlast is, on each machine where both were timed in one run."""
    found = []
    for machine in machines("original"):
        *rows, mean = (row["times faster"] for row in read("original", machine)[1])
        least, most = min(map(float, rows)), max(map(float, rows))
        found.append([about("original", machine).partition("; the original")[0], mean, f"{least:.0f} to {most:.0f}"])
    return markdown(["machine", "geometric mean of the variants", "all rows"], found)


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column has words, and all others numbers."""
    lines = [f"| {' | '.join(cells)} |" for cells in (columns, *rows)]
    return "\n".join([lines[0], "|---|" + "---:|" * (len(columns) - 1), *lines[1:], ""])


def draw(machine: str) -> None:
    """World-steps a second against the number of worlds: ours and plain Box2D, of one run."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    _, rows = read("worlds", machine)
    names = [name for name in rows[0] if name != "worlds" and not name.endswith(" box2d")]
    figure, axes = pyplot.subplots(1, len(names), figsize=(4.6 * len(names), 3.6), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for column, label, colour in (
            (name, "outlast, whole step", "#0072b2"),
            (f"{name} box2d", "Box2D alone", "#d55e00"),
        ):
            points = [(int(row["worlds"]), 1e6 / float(row[column])) for row in rows if row[column]]
            axis.loglog(*zip(*points, strict=True), marker="o", markersize=4, color=colour, label=label)
        axis.set_title(name)
        axis.set_xlabel("worlds in the batch")
        axis.grid(alpha=0.3, which="major")
    axes[0, 0].set_ylabel("world-steps a second, one core")
    axes[0, 0].legend(loc="best", frameon=False)
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=130)


if __name__ == "__main__":
    main()
