"""Tables of numbers in Markdown."""

from collections.abc import Iterable, Sequence


def number(value: float) -> str:
    """A number with as many digits as mean something."""
    return f"{value:,.{decimals(value)}f}"


def decimals(value: float) -> int:
    """Digits behind the point."""
    return sum(abs(value) < bound for bound in (100, 10, 1))


def markdown_table(heads: Sequence[str], lines: Iterable[list[str]]) -> str:
    """A table in Markdown, numbers to the right, without the columns that have nothing in them."""
    table = list(lines)
    kept = [k for k in range(len(heads)) if k == 0 or any(line[k] for line in table)]
    every = [list(heads), ["---", *["---:"] * (len(heads) - 1)], *table]
    return "\n".join("| " + " | ".join(line[k].replace("|", r"\|") for k in kept) + " |" for line in every)
