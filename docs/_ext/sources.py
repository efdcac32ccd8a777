"""Helpers of the tables: Markdown, docstrings, and comments at the end of a line."""

import ast
import inspect
import io
import tokenize
from collections.abc import Iterable, Sequence
from typing import Any


def comments(cls: type) -> dict[str, str]:
    """The comment on the last line of each attribute's declaration in `cls`; attributes without one are left out."""
    source = inspect.getsource(cls)
    notes = {
        token.start[0]: token.string.removeprefix("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    (body,) = ast.parse(source).body
    assert isinstance(body, ast.ClassDef)
    found = {}
    for line in body.body:
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name) and line.end_lineno in notes:
            found[line.target.id] = notes[line.end_lineno]
    return found


def summary(documented: Any) -> str:
    """A docstring's text on one line, without the headings and the examples that may follow."""
    return " ".join(inspect.cleandoc(documented.__doc__ or "").split(">>>")[0].split())


def grid(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown, without the columns that have nothing in them."""
    lines = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    kept = [k for k in range(len(heads)) if any(line[k] for line in lines)]
    table = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(line[k] for k in kept) + " |" for line in table)


def code(text: Any) -> str:
    """As code, or nothing."""
    return f"`{text}`" if str(text) else ""
