"""Helpers of the tables: writing Markdown, and reading docstrings and comments at the ends of lines."""

import ast
import inspect
import io
import tokenize
from collections.abc import Iterable, Sequence
from typing import Any


def comments(cls: type) -> dict[str, str]:
    """Return, by attribute of `cls`, the comment on the last line of its declaration; only attributes that have one."""
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
    """Return a docstring's text on one line, without the examples and what follows them."""
    return " ".join(inspect.cleandoc(documented.__doc__ or "").split(">>>")[0].split())


def grid(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown, without columns that are empty."""
    lines = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    kept = [k for k in range(len(heads)) if any(line[k] for line in lines)]
    table = [heads, ["---"] * len(heads), *lines]
    return "\n".join("| " + " | ".join(line[k] for k in kept) + " |" for line in table)


def code(text: Any) -> str:
    """Return a text as code in Markdown; "" if it is empty."""
    return f"`{text}`" if str(text) else ""
