"""Tables of numbers in Markdown and as CSV."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from .statistics import interval

ENDS = "ends.csv"  # the file of end values, beside a figure
NONE = "–"  # for values that cannot be measured, such as the distance to mates in a game without them


def number(value: float) -> str:
    """Format a number with its meaningful digits."""
    return f"{value:,.{decimals(value)}f}"


def digits(value: float) -> str:
    """Format a number with six significant digits, for a file; "" for NaN."""
    return "" if math.isnan(value) else f"{value:.6g}"


def spread(values: Sequence[float]) -> str:
    """Format the 95 % bootstrap interval of a mean over runs, see statistics.interval; "" for a single run."""
    ends = interval(values)
    return "" if ends is None else f"{number(ends[0])} to {number(ends[1])}"


def with_spread(values: Sequence[float]) -> str:
    """Return the mean over runs, and its interval: "653 (594 to 713)"."""
    mean, ends = number(sum(values) / len(values)), spread(values)
    return f"{mean} ({ends})" if ends else mean


def with_error(mean: float, error: float) -> str:
    """Write a mean and its standard error, to the error's second digit: "0.512 ± 0.025"."""
    if math.isnan(mean):
        return "-"
    if math.isnan(error):  # it was measured in one episode only
        return f"{mean:.2f} ± -"
    if not error:  # all episodes were alike
        return f"{mean:.2f}"
    digits = min(max(1 - math.floor(math.log10(error)), 0), 4)
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def pivot(rows: Sequence[Sequence[str]], down: int, across: int) -> tuple[list[str], list[list[str]]]:
    """Return the heads and the lines of a table of means and errors, by two cells of each row.

    rows: The last two cells are the mean and its error, as text. down, across: Which cells begin a line, and which are
    the heads of the columns; if these are the same names, they come in the same order.
    """
    names, heads = (list(dict.fromkeys(row[k] for row in rows)) for k in (down, across))
    heads = names if {*names} == {*heads} else heads
    cells = {(row[down], row[across]): with_error(*(float(cell or "nan") for cell in row[-2:])) for row in rows}
    return heads, [[name, *(cells.get((name, head), "") for head in heads)] for name in names]


def decimals(value: float) -> int:
    """Return the number of digits after the decimal point."""
    return sum(abs(value) < bound for bound in (100, 10, 1))


def markdown_table(heads: Sequence[str], lines: Iterable[list[str]]) -> str:
    """Write a table in Markdown, with numbers aligned right and without empty columns."""
    table = list(lines)
    kept = [k for k in range(len(heads)) if k == 0 or any(line[k] for line in table)]
    every = [list(heads), ["---", *["---:"] * (len(heads) - 1)], *table]
    return "\n".join("| " + " | ".join(line[k].replace("|", r"\|") for k in kept) + " |" for line in every)


def csv_text(heads: Iterable[Any], rows: Iterable[Iterable[Any]]) -> str:
    """Write a table as CSV, with a line feed after each row."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    return text.getvalue()
