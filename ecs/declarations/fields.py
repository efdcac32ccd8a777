"""Fields: the named numbers in each row of an observation, declared by its column or added by other mechanics.

    own: Array = column("f4", "agents", fields=(Field("id", order=-1), Field("x", "m", scale=half_room)))

The row is as long as all fields of its key together. A mechanic adds fields with Module.fields; kernels get a field's
position from an Offset parameter (declarations.access), all other code from Layout.fields.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..kernels.errors import DeclarationError, did_you_mean
from ..kernels.integers import is_whole

SMALLEST = 1e-9  # the smallest scale: networks multiply by its inverse in float32
Fields = Mapping[str, Mapping[str, "Field"]]  # by the observation's key and by name, in the order of their columns


@dataclass(frozen=True)
class Field:
    """A named number in each row of an observation, or `size` numbers that belong together, such as vertices.

    Attributes:
        name: Name, unique among the fields of a key.
        unit: Unit, such as "m", "rad" or "hit points"; "" for numbers without a unit, such as ids.
        scale: Divisor that gives values of about -1 to 1: a float; a declaration may also give a function of the
            Layout, whose result replaces it.
        low: Inclusive lower bound; the `bounds` of mechanics may narrow it.
        high: Inclusive upper bound; may be narrowed in the same way.
        size: Number of columns: an int; a declaration may also give the name of a dimension, which the layout replaces
            by its size.
        order: Fields of a key are sorted by this number. Among equal ones, those that the column declares come first,
            as declared, then those of other mechanics in the order of the mechanics' names.
        start: Its first column, which the layout sets.

    Raises:
        DeclarationError: The name, size, order or range is not valid.
    """

    name: str
    unit: str = ""
    scale: Any = 1.0
    low: float = -math.inf
    high: float = math.inf
    size: Any = 1
    order: int = 0
    start: int = 0

    def __post_init__(self) -> None:
        name: Any = self.name
        if not isinstance(name, str) or not re.fullmatch("[a-z][a-z0-9_]*", name):
            raise DeclarationError(
                f"a field is called {self.name!r}: lower-case letters, digits and underscores are needed, as in "
                'Field("stamina")'
            )
        if not (is_whole(self.size) or isinstance(self.size, str)) or not is_whole(self.order):
            raise DeclarationError(
                f"the field '{self.name}' has size {self.size!r:.60} and order {self.order!r:.60}: integers are "
                "needed, or as the size the name of a dimension"
            )
        if (not isinstance(self.size, str) and self.size < 1) or not self.low <= self.high:
            raise DeclarationError(
                f"the field '{self.name}' has size {self.size} and the range {self.low:g} to {self.high:g}: a size of "
                "at least 1 and a low end that is not above the high one are needed"
            )

    @property
    def columns(self) -> slice:
        """The slice of its columns in the row."""
        return slice(self.start, self.start + self.size)


def width(fields: Mapping[str, Field]) -> int:
    """Return the length of a row of these fields."""
    return sum(field.size for field in fields.values())


def columns_of(fields: Mapping[str, Field], *names: str) -> Any:
    """Return the positions of some fields in the last axis of an observation.

    >>> place = observations["own"][..., columns_of(env.fields["own"], "x", "y")]

    Args:
        fields: The fields of the observation's key.
        *names: One field of size 1 gives an integer. Several give their columns in this order: as a slice if they are
            adjacent (the indexed result is then a view).

    Raises:
        KeyError: A field does not exist.
    """
    if missing := [name for name in names if name not in fields]:
        raise KeyError(f"unknown field '{missing[0]}'; known: {', '.join(fields)}")
    if len(names) == 1 and fields[names[0]].size == 1:
        return fields[names[0]].start
    found = [k for name in names for k in range(fields[name].start, fields[name].columns.stop)]
    span = slice(found[0], found[-1] + 1)
    return span if found == list(range(span.start, span.stop)) else found


def column_names(fields: Mapping[str, Field]) -> list[str]:
    """Return the names of a row's columns: those of its fields; "corners.0", "corners.1" ... if a field has several."""
    return [name if field.size == 1 else f"{name}.{k}" for name, field in fields.items() for k in range(field.size)]


def offset(fields: Fields, name: str, label: str) -> int:
    """Return the first column of the field named by an Offset parameter, KEY_FIELD.

    Args:
        fields: Layout.fields.
        name: The parameter's name.
        label: The system's label, for errors.

    Raises:
        DeclarationError: No field has that name, or more than one has it.
    """
    known = [(f"{key}_{field.name}", key, field) for key, named in fields.items() for field in named.values()]
    found = [(key, field) for full, key, field in known if full == name]
    if len(found) == 1:
        return found[0][1].start
    if found:
        owners = " and ".join(f"'{field.name}' of '{key}'" for key, field in found)
        raise DeclarationError(
            f"{label}: the Offset '{name}' could be the field {owners}; rename one of them, or its observation"
        )
    names = [full for full, _, _ in known]
    keys = {key for _, key, _ in known if name.startswith(f"{key}_")}
    listed = [full for full, key, _ in known if key in keys] or names
    raise DeclarationError(
        f"{label}: the Offset '{name}' does not name a field (KEY_FIELD, as in own_health)"
        + (did_you_mean(name, names, before="; ") or ";")
        + f" Known: {', '.join(listed) or 'none'}"
    )
