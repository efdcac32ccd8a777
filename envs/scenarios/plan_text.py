"""Floor plans drawn in characters, converted to rectangles."""

import textwrap
from collections.abc import Collection

from ..errors import ScenarioError

BLANK = ". "
LONGEST = 1000  # characters of a line, and number of lines, at most
Place = tuple[float, float, float, float, float]


def parsed(text: str, cell: float, signs: Collection[str]) -> tuple[list[tuple[str, Place]], int, int]:
    """Return the rectangles of each sign in a drawing.

    Args:
        text: The lines of the drawing; blank lines around them and their common indentation are ignored.
        cell: Side of the square that a character stands for, metres.
        signs: The characters that mean something, apart from those of floor.

    Returns:
        Sign and (x, y, width, height, angle) of each rectangle, metres; the drawing's numbers of columns and rows.

    Raises:
        ScenarioError: A character has no meaning, or there are no lines.
    """
    lines = [line.rstrip() for line in textwrap.dedent(text).splitlines()]
    while lines and not lines[0]:
        del lines[0]
    while lines and not lines[-1]:
        del lines[-1]
    columns, rows = max(map(len, lines), default=0), len(lines)
    if not 0 < columns <= LONGEST or rows > LONGEST:
        raise ScenarioError(f"a drawing of {columns} x {rows} characters: 1 to {LONGEST} either way are needed")
    grid = [list(line.ljust(columns)) for line in lines]
    found = []
    for row in range(rows):
        for column in range(columns):
            sign = grid[row][column]
            if sign in BLANK:
                continue
            if sign not in signs:
                raise ScenarioError(
                    f"line {row + 1}, column {column + 1}: {sign!r} means nothing; # is a wall, . is floor, A to Z are "
                    "where sides start, * where items do; other signs stand for kinds, as in kinds={'c': 'crate'}"
                )
            wide, high = _cut_out(grid, row, column, sign)
            x, y = column + wide / 2 - columns / 2, rows / 2 - row - high / 2
            found.append((sign, (x * cell, y * cell, wide * cell, high * cell, 0.0)))
    return found, columns, rows


def _cut_out(grid: list[list[str]], row: int, column: int, sign: str) -> tuple[int, int]:
    """Cut a rectangle of a sign out of the grid, from here as far to the right as it goes, then as far down."""
    wide = high = 1
    while column + wide < len(grid[0]) and grid[row][column + wide] == sign:
        wide += 1
    while row + high < len(grid) and grid[row + high][column : column + wide] == [sign] * wide:
        high += 1
    for line in grid[row : row + high]:
        line[column : column + wide] = "." * wide
    return wide, high
