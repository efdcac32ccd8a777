"""The values of the abstract interpreter: what a variable of a kernel may hold, and where numba's code defines it."""

import inspect
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import FunctionType
from typing import Any, Protocol

import numpy as np
from numba.core import ir

from ..compilation.cache_key import FOREIGN
from ..declarations.component import Component
from ..memory.layout import MemoryLayout

FIELD = 1 << 16  # a value of Column.axes, see there
UNKNOWN, FLOATING = "unknown", "floating"  # any value; a float that does not come from a column
Values = frozenset[Any]  # what a variable may hold; a tuple is a tuple of such sets
ANYTHING: Values = frozenset([UNKNOWN])


class Calls(Protocol):
    """What follows calls of functions: the check of a system, kernel_check._Check."""

    label: str
    offsets: dict[tuple[type[Component], str], set[str]]  # see System.offsets
    used: set[tuple[type[Component], str]]  # columns that were looked up
    written: set[tuple[type[Component], str]]
    layout: MemoryLayout | None  # that of the worlds

    def call(
        self, function: FunctionType, arguments: dict[str, Values], trail: tuple[str, ...], report: bool
    ) -> Values:
        """The values that `function` returns."""


@dataclass(frozen=True)
class Table:
    """The table of a component; access: "read", "write" or "add"."""

    component: type[Component]
    access: str


@dataclass(frozen=True)
class Column:
    """A column of a table, or an element or a slice of a column.

    Attributes:
        component: The table's component.
        access: "read", "write" or "add".
        name: The column's name.
        part: Whether it is an element or a slice.
        method: The method of the array that was looked up, one of WRITING or VIEWS; "" for none.
        axes: How many of its axes have an index already that is no slice; FIELD once its last axis has a slice that
            begins at a number that is no literal, such as an Offset.
    """

    component: type[Component]
    access: str
    name: str
    part: bool = False
    method: str = ""
    axes: int = 0

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of its elements."""
        return self.component.columns[self.name].dtype

    @property
    def ndim(self) -> int:
        """How many axes the column has in a world, if its component is a Singleton."""
        return len(self.component.columns[self.name].dims)

    def at(self, index: Any) -> "Column":
        """The part of it that an index selects."""
        count, last, slices = parts_of(index)
        field = self.axes + count >= self.ndim and isinstance(last, Slice) and not isinstance(last.start, Constant)
        return replace(self, part=True, method="", axes=FIELD if field else self.axes + count - slices)

    def __str__(self) -> str:
        return f"{self.component.__name__}.{self.name}"


@dataclass(frozen=True)
class Slice:
    """An index that selects several elements. start, stop: the abstract values of the first index and of the end."""

    start: Any
    stop: Any = UNKNOWN


def parts_of(index: Any) -> tuple[int, Any, int]:
    """The parts of an index: how many, the value of the last one, and how many are slices."""
    parts = index if isinstance(index, tuple) and index else (frozenset([index]),)
    last = next(iter(parts[-1])) if len(parts[-1]) == 1 else UNKNOWN
    return len(parts), last, sum(any(isinstance(each, Slice) for each in part) for part in parts)


@dataclass(frozen=True)
class Member:
    """An integer that says something of the rows with certain components.

    Attributes:
        what: "row" is one of them, "index" the index of one in Rows[components], "size" how many there are.
        components: The components.
    """

    what: str
    components: tuple[type[Component], ...]


@dataclass(frozen=True)
class Shared:
    """A read-only array that is the same for all worlds: rows, or numbers.

    Attributes:
        name: The parameter's name.
        kind: The kind of the parameter; "enumerate" for enumerate(...) of rows.
        components: What entities must have, if it selects entities.
    """

    name: str
    kind: str
    components: tuple[type[Component], ...] = ()

    def __str__(self) -> str:
        return f"'{self.name}'"

    def has(self, name: str) -> Values:
        """Its attribute of that name; or an "element", its "len" or "enumerate"."""
        if name == "shape":
            return frozenset([(self.has("size"),)])
        if name == "enumerate" and self.kind == "rows":
            return frozenset([replace(self, kind="enumerate")])
        if self.kind == "enumerate":
            return frozenset([tuple(frozenset([Member(each, self.components)]) for each in ("index", "row"))])
        whole = {"size": "size", "len": "size", "element": "row"} if self.kind == "rows" else {}
        what = "index" if (self.kind, name) == ("row_index", "element") else whole.get(name)
        return frozenset([Member(what, self.components)]) if what else ANYTHING


@dataclass(frozen=True)
class PerAgent:
    """A number in which roles differ, which kernels get as an array. name: the parameter's name."""

    name: str

    def __str__(self) -> str:
        return f"'{self.name}'"


@dataclass(frozen=True)
class Interval:
    """An integer that a loop over literal numbers counts, and what is computed from it. Both ends are included."""

    low: int
    high: int


def interval(value: Any) -> Interval | None:
    """The integers that an abstract value may be; None if that is not known."""
    if isinstance(value, Constant) and isinstance(value.value, int):
        return Interval(value.value, value.value)
    return value if isinstance(value, Interval) else None


def rounds(arguments: Sequence[Any]) -> range:
    """What a loop over range(*arguments) counts; nothing if one is no known integer, or range does not take them."""
    known = [each for each in arguments if isinstance(each, int)]
    fit = len(known) == len(arguments) and 1 <= len(known) <= 3 and 0 not in known[2:]
    return range(*known) if fit else range(0)


def counted(arguments: list[Any]) -> Values:
    """What a loop over range(*arguments) counts. arguments: abstract values."""
    for size in arguments[:2][-1:]:
        if isinstance(size, Member) and size.what == "size":
            return frozenset([Member("index", size.components)])
    steps = rounds([value.value if isinstance(value, Constant) else None for value in arguments])
    return frozenset([Interval(min(steps), max(steps))]) if steps else ANYTHING


@dataclass(frozen=True)
class Place:
    """A column in the rows of an observation, computed from an Offset.

    Attributes:
        name: The parameter's name.
        size: How many columns the field has.
        shift: How many columns it is behind the field's first one; None if a number was added that is not known.
    """

    name: str
    size: int
    shift: Interval | None = Interval(0, 0)

    def beyond(self, end: bool = False) -> bool:
        """Whether it is a column of another field: surely, or most likely if a field of one column is left.

        Args:
            end: Whether it is the end of a slice, which is not a part of it.
        """
        if self.shift is None:
            return self.size == 1 and not end
        return not 0 <= self.shift.low <= self.shift.high < self.size + end


def computed(function: Any, operands: list[Values]) -> Values:
    """The sum, difference or product of Places and known integers; an empty set if the operation is anything else."""
    if len(operands) != 2 or function not in (operator.add, operator.sub, operator.mul):
        return frozenset()
    one, other = (next(iter(values)) if len(values) == 1 else UNKNOWN for values in operands)
    if isinstance(other, Place) and function is operator.add:
        one, other = other, one
    by = interval(other)
    if isinstance(one, Place) and function is not operator.mul:
        return frozenset([replace(one, shift=by and one.shift and _computed(function, one.shift, by))])
    left = interval(one)
    return frozenset([_computed(function, left, by)] if left and by else [])


def _computed(function: Any, one: Interval, other: Interval) -> Interval:
    ends = [function(each, end) for each in (one.low, one.high) for end in (other.low, other.high)]
    return Interval(min(ends), max(ends))


@dataclass(frozen=True)
class Sum:
    """The sum of an element of a column that is declared Add and something added to it, before it is stored."""

    column: Column


@dataclass(frozen=True, eq=False)
class Constant:
    """A Python object, such as a module or a kernel; equal only to a Constant of the same object."""

    value: Any

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Constant) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


def bounded(function: Any, operands: list[Values]) -> set[Any]:
    """The Members that a comparison may keep in bounds: those that it compares with something other than a literal."""
    if function not in (operator.lt, operator.le, operator.gt, operator.ge):
        return set()
    if any(isinstance(value, Constant) for values in operands for value in values):
        return set()
    return {value for values in operands for value in values if isinstance(value, Member)}


def component_name(value: Any) -> str:
    """The name of the component of a table or a column."""
    return str(value.component.__name__)


def can_follow(called: Any) -> bool:
    """Whether it is a Python function without *args and **kwargs, and not from a package that numba handles itself."""
    if not isinstance(called, FunctionType) or called.__module__.partition(".")[0] in FOREIGN:
        return False
    kinds = {parameter.kind for parameter in inspect.signature(called).parameters.values()}
    return not kinds & {inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD}


def tracked(values: Values) -> bool:
    """Whether a Table, a Column or a Shared array is among the values."""
    return any(
        isinstance(v, (Table, Column, Shared)) or (isinstance(v, tuple) and any(map(tracked, v))) for v in values
    )


def added(*several: Values) -> Iterator[Table | Column]:
    """Yield the tables and columns among the values that are declared Add."""
    for value in (value for values in several for value in values):
        value = value.column if isinstance(value, Sum) else value
        if isinstance(value, tuple):
            yield from added(*value)
        elif isinstance(value, (Table, Column)) and value.access == "add":
            yield value


class Definitions:
    """Where the intermediate representation of a function defines its variables."""

    def __init__(self, statements: list[Any]) -> None:
        self._all: dict[str, list[Any]] = {}
        for statement in statements:
            if isinstance(statement, ir.Assign):
                self._all.setdefault(statement.target.name, []).append(statement.value)

    def is_addition(self, statement: Any) -> bool:
        """Whether a store is the last step of `column[index] += ...` or -=, which are a load, a sum and a store."""
        total = self._only(statement.value)
        element = self._only(total.lhs) if isinstance(total, ir.Expr) and total.op == "inplace_binop" else None
        return (
            isinstance(element, ir.Expr)
            and element.op == "getitem"
            and self._same(element.value, statement.target)
            and self._same(element.index, statement.index)
        )

    def _source(self, variable: Any) -> Any:
        """The variable that a temporary one is a copy of: numba calls these $... and copies them between blocks."""
        while variable.name.startswith("$") and len(self._all.get(variable.name, ())) == 1:
            (definition,) = self._all[variable.name]
            if not isinstance(definition, ir.Var):
                break
            variable = definition
        return variable

    def _only(self, variable: Any) -> Any:
        """The only definition of a temporary variable; None for the code's own variables, which may have changed."""
        variable = self._source(variable)
        found = self._all.get(variable.name, [])
        return found[0] if variable.name.startswith("$") and len(found) == 1 else None

    def _same(self, one: Any, other: Any) -> bool:
        """Whether two variables are the same, equal constants, or slices with the same ends."""
        if self._source(one).name == self._source(other).name:
            return True
        left, right = self._only(one), self._only(other)
        if isinstance(left, (ir.Const, ir.Global)) and isinstance(right, (ir.Const, ir.Global)):
            return left.value is right.value
        if not all(isinstance(each, ir.Expr) and each.op == "call" for each in (left, right)):
            return False
        function = self._only(left.func)
        ends = len(left.args) == len(right.args) and all(map(self._same, left.args, right.args))
        return (
            isinstance(function, ir.Global) and function.value is slice and self._same(left.func, right.func) and ends
        )


def floating(values: Values) -> bool:
    """Whether all values are floats, of columns or not; False if there are none."""
    return bool(values) and all(
        value == FLOATING or (isinstance(value, Column) and value.dtype.kind == "f") for value in values
    )
