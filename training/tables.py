"""Tables of numbers in Markdown."""

from collections.abc import Iterable, Sequence

from .statistics import interval

ENDS = "ends.csv"  # the file of end values, beside a figure
NONE = "–"  # of what there cannot be, as a distance to mates in a game without them


def number(value: float) -> str:
    """Return a number with all significant digits."""
    return f"{value:,.{decimals(value)}f}"


def spread(values: Sequence[float]) -> str:
    """Return the 95 % bootstrap interval of a mean over runs (see statistics.interval); "" for a single run."""
    ends = interval(values)
    return "" if ends is None else f"{number(ends[0])} to {number(ends[1])}"


def with_spread(values: Sequence[float]) -> str:
    """Return the mean over runs, and that interval: "653 (594 to 713)"."""
    mean, ends = number(sum(values) / len(values)), spread(values)
    return f"{mean} ({ends})" if ends else mean


def decimals(value: float) -> int:
    """Return how many digits to show after the point."""
    return sum(abs(value) < bound for bound in (100, 10, 1))


def markdown_table(heads: Sequence[str], lines: Iterable[list[str]]) -> str:
    """Return a table in Markdown, with numbers right-aligned, and without empty columns."""
    table = list(lines)
    kept = [k for k in range(len(heads)) if k == 0 or any(line[k] for line in table)]
    every = [list(heads), ["---", *["---:"] * (len(heads) - 1)], *table]
    return "\n".join("| " + " | ".join(line[k].replace("|", r"\|") for k in kept) + " |" for line in every)
