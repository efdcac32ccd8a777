"""Places of the fields of observations in their rows: those that a column declares, and those that mechanics add."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..kernels.errors import DeclarationError, did_you_mean
from .component import Column
from .fields import SMALLEST, Field
from .layout import Layout
from .module import Module


def placed(
    layout: Layout, modules: Sequence[Module], observations: Mapping[str, tuple[str, Column]], imported: set[str]
) -> dict[str, dict[str, Field]]:
    """Return the fields of all observations by key and name, in order of columns, with `start` and `scale` as numbers.

    Args:
        layout: The layout, of which scales may be functions.
        modules: The mechanics, with the fields that they add.
        observations: For each key, the mechanic that declares it, and its Column.
        imported: Keys of all observations that any imported mechanic declares. Fields added to a key that this scenario
            lacks are left out, like the mechanic that declares it.

    Raises:
        DeclarationError: Fields are added to a key that no mechanic declares, or that has no fields of its own; two
            fields have the same name; a scale is too small or not a number; or a size names no dimension.
    """
    found = {
        key: [(field.order, owner, field) for field in column.fields]
        for key, (owner, column) in observations.items()
        if column.fields and not isinstance(column.fields, str)
    }
    for module in modules:
        for key, added in _added(module):
            if key in found:
                found[key] += [(field.order, module.name, field) for field in added]
            elif key in observations or key not in imported:
                raise DeclarationError(_not_extended(module.name, key, observations, {*found, *imported}))
    result = {key: dict(_in_order(layout, key, entries)) for key, entries in sorted(found.items())}
    for key, (owner, column) in observations.items():
        if isinstance(column.fields, str):
            if column.fields not in result:
                raise DeclarationError(
                    f"the rows of '{key}' ({owner}) have the fields of '{column.fields}', which declares none here; "
                    "add the mechanic that does, or declare fields=(Field(...), ...)"
                )
            result[key] = result[column.fields]
    return result


def _added(module: Module) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Yield what a module's fields() returns, by key, after checking it."""
    given: Any = module.fields()
    for key, added in given.items() if isinstance(given, Mapping) else [("", given)]:
        if not (key and isinstance(added, tuple | list) and all(isinstance(field, Field) for field in added)):
            raise DeclarationError(
                f"{module.name}.fields() returned {given!r:.60}: a tuple of Field by key is needed, as in "
                'return {"own": (Field("stamina"),)}; with one, mind the comma'
            )
        yield key, tuple(added)


def _in_order(layout: Layout, key: str, entries: list[tuple[int, str, Field]]) -> Iterator[tuple[str, Field]]:
    owners: dict[str, str] = {}
    start = 0
    for _, owner, field in sorted(entries, key=lambda entry: entry[0]):
        if field.name in owners:
            raise DeclarationError(
                f"'{field.name}' is a field of '{key}' of both {owners[field.name]} and {owner}; rename one of them"
            )
        owners[field.name] = owner
        scale = float(field.scale(layout) if callable(field.scale) else field.scale)
        if not SMALLEST <= scale < math.inf:
            raise DeclarationError(
                f"the field '{field.name}' of '{key}' ({owner}) has the scale {scale:g}: a number of at least "
                f"{SMALLEST:g} is needed, such as the largest value that is usual"
            )
        size = layout.dims.get(field.size) if isinstance(field.size, str) else field.size
        if not size:
            raise DeclarationError(
                f"the field '{field.name}' of '{key}' ({owner}) is as long as the dimension '{field.size}', which is 0 "
                f"or not defined; known: {', '.join(sorted(layout.dims))}"
            )
        yield field.name, replace(field, scale=scale, start=start, size=size)
        start += size


def _not_extended(module: str, key: str, observations: Mapping[str, tuple[str, Column]], known: set[str]) -> str:
    """Return why a module cannot add fields to a key."""
    if key not in observations:
        hint = did_you_mean(key, sorted(known)) or f"known are {', '.join(sorted(known))}"
        return f"{module} adds fields to the observation '{key}', which no mechanic declares; {hint}"
    owner, column = observations[key]
    if column.fields:
        return f"{module} adds fields to '{key}', whose rows have the fields of '{column.fields}': add them to that"
    return (
        f"{module} adds fields to '{key}', which {owner} declares without any: declare its columns by "
        'column("f4", ..., fields=(Field(...), ...)), or publish an observation of your own'
    )
