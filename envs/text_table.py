"""Tables as text: aligned columns that fit the terminal, where there is one."""

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest

GAP = 2  # characters between columns
LEAST = 30  # characters: if the last column of words has less room, it is written below its row
INDENT = 4  # of what is written below a row

Row = Sequence[str]


def terminal_width() -> int | None:
    """Return the characters in a line of standard output; None: as many as needed, as in pipes and files.

    The variable COLUMNS sets it, for pipes and files, too.
    """
    if (given := os.environ.get("COLUMNS", "")).strip("0").isdecimal():
        return int(given)
    return shutil.get_terminal_size().columns if sys.stdout is not None and sys.stdout.isatty() else None


def text_table(rows: Iterable[Row], head: Row = (), *, left: int | None = None, width: int | None = None) -> str:
    """Return a table as lines of at most `width` characters, as far as single words and numbers allow.

    Columns of words are wrapped, or the last one is written below its row. Columns of numbers that have no room are
    written in further tables below, each with the columns of words.

    left: How many columns are words, on the left; those after them are numbers. None: all. width: See `terminal_width`.
    """
    lines = [*([head] if head else []), *rows]
    if not lines:
        return ""
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    words = len(widths) if left is None else left
    if width is None or _length(widths) <= width:
        return "\n".join(_aligned(line, widths, words) for line in lines)
    return "\n".join(_wrapped(lines, widths, width)) if words == len(widths) else _divided(lines, widths, words, width)


def _divided(lines: Sequence[Row], widths: Sequence[int], words: int, width: int) -> str:
    """Return tables with as many of the numbers as fit, at least one."""
    parts: list[list[int]] = [[]]
    for k in range(words, len(widths)):
        if parts[-1] and _length([*widths[:words], *(widths[j] for j in (*parts[-1], k))]) > width:
            parts.append([])
        parts[-1].append(k)
    tables = []
    for columns in ([*range(words), *part] for part in parts):
        shown = [widths[k] for k in columns]
        tables.append("\n".join(_aligned([line[k] for k in columns], shown, words) for line in lines))
    return "\n\n".join(tables)


def _wrapped(lines: Sequence[Row], widths: Sequence[int], width: int) -> Iterator[str]:
    """Yield the lines of a table of words, in which a row may take several."""
    *others, last = widths
    room = width - _length(others) - GAP
    below = room < min(LEAST, last)
    sizes = _shrunk(others, lines, width) if below else [*others, room]
    for line in lines:
        cells = [_Wrapper(size).wrap(cell) for cell, size in zip(line, sizes, strict=not below)]
        for parts in zip_longest(*cells, fillvalue=""):
            yield _aligned(parts, sizes, len(sizes))
        if below:
            yield from _Wrapper(width, INDENT * " ").wrap(line[-1])


def _shrunk(widths: Sequence[int], lines: Sequence[Row], width: int) -> list[int]:
    """Return widths that fit, as far as the longest words allow: the widest columns give way first, names never."""
    split = _Wrapper.wordsep_simple_re.split  # into parts that cannot be broken
    least = [max(len(part) for cell in cells for part in split(cell)) for cells in zip(*lines, strict=True)]
    shrunk = list(widths)
    while _length(shrunk) > width and (wide := [k for k, size in enumerate(shrunk) if k and size > max(1, least[k])]):
        shrunk[max(wide, key=lambda k: shrunk[k])] -= 1
    return shrunk


class _Wrapper(textwrap.TextWrapper):
    """A wrapper that breaks lines at spaces, behind commas, and between words with a hyphen; never within numbers."""

    wordsep_simple_re = re.compile(r"(\s+|(?<=,)|(?<=[a-z]-)(?=[a-z]))")

    def __init__(self, width: int, indent: str = "") -> None:
        super().__init__(max(width, len(indent) + 1), initial_indent=indent, subsequent_indent=indent)
        self.break_long_words = self.break_on_hyphens = False


def _length(widths: Sequence[int]) -> int:
    return sum(widths) + GAP * (len(widths) - 1)


def _aligned(cells: Row, widths: Sequence[int], words: int) -> str:
    """Return a line: words on the left of their columns, numbers on the right."""
    padded = (
        cell.ljust(width) if k < words else cell.rjust(width)
        for k, (cell, width) in enumerate(zip(cells, widths, strict=True))
    )
    return (GAP * " ").join(padded).rstrip()
