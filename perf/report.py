"""The tables and the plot of docs/performance.md, and README's table, from the results of one machine.

    python -m perf.report MACHINE      (needs matplotlib: pip install 'outlast[plot]')

A document says where a table goes with a pair of comments, <!-- table NAME: column, ... --> and <!-- end -->; what is
between them is replaced. NAME is a file of perf/results/MACHINE; the columns named are shown, all of them if none is.
"""

import argparse
import re
from pathlib import Path

from perf.rows import ROWS
from perf.table import FOLDER, read

ROOT = Path(__file__).parent.parent
DOCUMENTS = (ROOT / "docs" / "performance.md", ROOT / "README.md")
TABLE = re.compile(r"(<!-- table (?P<name>[\w-]+)(?:: (?P<columns>[^>]*?))? -->\n).*?(<!-- end -->)", re.DOTALL)
MACHINE = re.compile(r"(<!-- machine -->).*?(<!-- end -->)", re.DOTALL)
FIGURE = ROOT / "docs" / "performance.png"


def main() -> None:
    """Rewrite the documents and draw the plot."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("machine", help=f"one of {', '.join(sorted(p.name for p in FOLDER.iterdir()))}")
    machine = options.parse_args().machine
    for document in DOCUMENTS:
        document.write_text(filled(document.read_text(), machine))
        print(document.relative_to(ROOT))
    draw(machine)
    print(FIGURE.relative_to(ROOT))


def filled(text: str, machine: str) -> str:
    """The text of a document with the tables of `machine`."""

    def table(match: re.Match[str]) -> str:
        rows = read(match["name"], machine)
        columns = match["columns"].split(", ") if match["columns"] else list(rows[0])
        lines = ["| " + " | ".join(columns) + " |", "|---|" + "---:|" * (len(columns) - 1)]
        lines += ["| " + " | ".join(row[column] for column in columns) + " |" for row in rows]
        return match[1] + "\n".join(lines) + "\n" + match[4]

    line = (FOLDER / machine / "machine.txt").read_text().strip()
    return TABLE.sub(table, MACHINE.sub(rf"\g<1>{line}\g<2>", text))


def draw(machine: str) -> None:
    """World-steps a second against the number of worlds: ours, plain Box2D, the original."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = read("worlds", machine)
    names = [name for name in rows[0] if name != "worlds" and not name.endswith(" box2d")]
    figure, axes = pyplot.subplots(1, len(names), figsize=(4.6 * len(names), 3.6), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for column, label, colour in (
            (name, "outlast, whole step", "#0072b2"),
            (f"{name} box2d", "Box2D alone", "#d55e00"),
        ):
            points = [(int(row["worlds"]), 1e6 / float(row[column])) for row in rows if row[column]]
            axis.loglog(*zip(*points, strict=True), marker="o", markersize=4, color=colour, label=label)
        original = next(row for row in ROWS if row.name == name).original
        axis.axhline(1e6 / original, color="#666666", linestyle="--", label="the original")
        axis.set_title(name)
        axis.set_xlabel("worlds in the batch")
        axis.grid(alpha=0.3, which="major")
    axes[0, 0].set_ylabel("world-steps a second, one core")
    axes[0, 0].legend(loc="center right", frameon=False)
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=130)


if __name__ == "__main__":
    main()
