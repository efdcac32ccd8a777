"""Stand-ins for what systems get, which refuse what a parameter list forbids. All values are those of plain arrays.

Rows and indices are integers that remember what they count: where agents have the first rows, the two are the same
numbers, so that a mechanic that confuses them works until another one brings entities that come before.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..declarations.component import Component
from ..kernels.errors import DeclarationError, EngineError, ScheduleError
from ..memory.layout import MemoryLayout

Array = np.ndarray[Any, Any]
COMPARED = ("eq", "ne", "lt", "le", "gt", "ge", "array")
WRITERS = (np.copyto, np.fill_diagonal, np.place, np.put, np.putmask)  # write their first argument
Columns = set[tuple[type[Component], str]]
READ_ONLY = "which its parameter list declares as Read; declare it Write[{}]"
ONLY_SUMS = "but declares Add[{0}], which allows column[...] += integer and -= only; declare Write[{0}]"
SIZES = ("dtype", "itemsize", "nbytes", "ndim", "shape", "size", "strides")  # attributes that do not show an element


class Refused(Exception):
    """What a system does against its declarations, and the kind of error that it is."""

    def __init__(self, text: str, kind: type[EngineError] = DeclarationError) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class Tag:
    """What an integer says of the rows that have `components`: "row", "index" among them, or "size"."""

    what: str
    components: tuple[type[Component], ...]


class Row(np.int32):
    """An element of a list of rows, or of a RowIndex."""

    tag: Tag


class Index(int):
    """A Python integer that knows what it counts; numpy takes it for a plain one."""

    tag: Tag

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = (int(each) if isinstance(each, Index) else each for each in inputs)
        return getattr(function, method)(*plain, **options)


def tagged(kind: Any, value: Any, what: str, components: tuple[type[Component], ...]) -> Any:
    """Return a Row or an Index of that value."""
    made = kind(value)
    made.tag = Tag(what, components)
    return made


class Watch:
    """The columns that a system has used and written, and `_wrong` for the layout of its worlds."""

    def __init__(self, layout: MemoryLayout) -> None:
        self.used, self.written = Columns(), Columns()
        self.misused = functools.cache(functools.partial(_wrong, layout))


@dataclass
class Guard:
    """What may be done with an array.

    Attributes:
        title: What errors call it.
        watch: What is known of the system.
        locked: Why nothing may be written to it; "": it may.
        dims: The dimensions of its axes, as far as indices are checked.
        gives: What its elements are; None: nothing special.
        computed: Whether it may be computed with.
        places: The last index of each of its elements, if some of these are not the system's own.
        own: Which of these indices are the system's own, and how errors name them.
        column: Component and name of the column that it is a part of.
    """

    title: str
    watch: Watch
    locked: str = ""
    dims: tuple[int | str, ...] = ()
    gives: Tag | None = None
    computed: bool = True
    places: Array | None = None
    own: tuple[Array, str] | None = None
    column: tuple[type[Component], str] | None = None

    def access(self, index: Any) -> None:
        """Refuse an index of the wrong kind."""
        if self.column:
            self.watch.used.add(self.column)
        for dim, part in zip(self.dims, index if isinstance(index, tuple) else (index,), strict=False):
            if isinstance(part, slice):
                break
            if (tag := getattr(part, "tag", None)) and (wrong := self.watch.misused(dim, tag)):
                raise Refused(f"indexes {self.title}, {wrong}")

    def write(self, index: Any, value: Any, dtype: np.dtype[Any]) -> None:
        """Refuse to write a value."""
        if self.locked:
            raise Refused(f"writes {self.title}, {self.locked}", ScheduleError)
        if isinstance(value, Watched) and value.guard:
            value.guard.compute()
        if dtype.kind in "iu" and cut(value):
            raise Refused(f"writes a float to {self.title}, {dtype}, which cuts it off; say so, as in np.{dtype}(...)")
        self.access(index)
        if self.places is not None and self.own and not self.own[0][self.reach(self.places, index)].all():
            raise Refused(f"writes {self.title} beside {self.own[1]}; take an Offset for each field")
        if self.column:
            self.watch.written.add(self.column)

    def reach(self, array: Any, index: Any) -> Any:
        """Return a part of an array. IndexError, with the title, if it has none."""
        try:
            return array[index]
        except IndexError as error:
            raise IndexError(f"{self.title}: {error}") from None

    def compute(self) -> None:
        """Refuse to compute with the whole array, where a system may take it for one number."""
        if not self.computed:
            raise Refused(
                f"computes with {self.title}, in which roles differ: write of({self.title}, e), where e is the row of "
                "the agent"
            )

    def part(self, index: Any) -> "Guard":
        """Return the guard of a part of the array."""
        return replace(self, dims=(), places=None if self.places is None else self.places[index])


class Watched(np.ndarray):
    """An array with a guard. What is computed from it, and views that numpy's functions make, have none."""

    guard: Guard | None

    def __array_finalize__(self, source: Any) -> None:
        self.guard = None

    def __array_ufunc__(self, ufunc: Any, method: Any, *inputs: Any, out: Any = (), **options: Any) -> Any:
        for each in inputs:
            if isinstance(each, Watched) and each.guard:
                each.guard.compute()
        for each in out:
            if isinstance(each, Watched) and each.guard:
                each.guard.write(..., None, each.dtype)
        if out:
            options["out"] = tuple(map(_plain, out))
        result = getattr(ufunc, method)(*map(_plain, inputs), **options)
        return out[0] if len(out) == 1 else result

    def __array_function__(self, function: Any, kinds: Any, arguments: Any, options: Any) -> Any:
        if function in WRITERS and isinstance(arguments[0], Watched) and arguments[0].guard:
            arguments[0].guard.write(..., None, arguments[0].dtype)
        return super().__array_function__(function, kinds, arguments, options)

    def __getitem__(self, index: Any) -> Any:
        plain, guard = _plain(self), self.guard
        if guard is None:
            return plain[index]
        guard.access(index)
        found = guard.reach(plain, index)
        if isinstance(found, np.ndarray):
            return watched(found, guard.part(index)) if np.may_share_memory(found, plain) else found
        return tagged(Row, found, guard.gives.what, guard.gives.components) if guard.gives and found >= 0 else found

    def __setitem__(self, index: Any, value: Any) -> None:
        if self.guard:
            self.guard.write(index, value, self.dtype)
            self.guard.reach(_plain(self), index)
        _plain(self)[index] = value


def _guarded(name: str, writes: bool) -> Any:
    """A method of arrays that writes all of it, or computes with it."""

    def method(self: Watched, *arguments: Any, **options: Any) -> Any:
        if self.guard and writes:
            self.guard.write(..., None, self.dtype)
        elif self.guard:
            self.guard.compute()
        return getattr(_plain(self), name)(*arguments, **options)

    return method


for _name in ("fill", "partition", "put", "sort", "__bool__", "__float__", "__int__"):
    setattr(Watched, _name, _guarded(_name, writes=not _name.startswith("__")))


class Selection(Watched):
    """The list of a Rows parameter, whose size is known to be that of the list."""

    @property
    def size(self) -> Any:
        """Its size."""
        gives = self.guard.gives if self.guard else None
        return tagged(Index, len(self), "size", gives.components) if gives else len(self)

    @property  # type: ignore[misc]
    def shape(self) -> Any:
        """Its only dimension."""
        return (self.size,)


def watched(array: Array, guard: Guard, kind: type[Watched] = Watched) -> Any:
    """Return the same array with a guard."""
    view = array.view(kind)
    view.guard = guard
    return view


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, Watched) else value


def cut(value: Any) -> bool:
    """Whether a column of integers cuts off what is written.

    numpy makes a float64 of an int and a uint64, where machine code has an integer: a whole one is none.
    """
    if not isinstance(value, (float, np.floating, np.ndarray)):
        return False
    array = np.asarray(value)
    whole = type(value) is not float and array.dtype == np.float64 and bool((array == np.floor(array)).all())
    return array.dtype.kind == "f" and not whole


class Added:
    """A column that is declared Add: all that it allows is column[...] += integer, and -=."""

    def __init__(self, array: Array, guard: Guard) -> None:
        self._array, self._guard = array, guard

    def __getitem__(self, index: Any) -> "Total":
        self._guard.access(index)
        return Total(self, index, self._guard.reach(self._array, index))

    def __setitem__(self, index: Any, value: Any) -> None:
        same = isinstance(value, Total) and value.column is self and value.changed
        if not same or not (value.index is index or (isinstance(index, slice) and value.index == index)):
            self.refuse("writes")
        self._guard.write(index, None, self._array.dtype)
        self._array[index] = value.value

    def __len__(self) -> int:
        return len(self._array)

    def __getattr__(self, name: str) -> Any:
        if name not in SIZES:
            self.refuse(f"takes .{name} of")
        return getattr(self._array, name)

    def refuse(self, does: str, why: str = "") -> None:
        """Raise Refused. does: what the system does with the column."""
        name, title = self._guard.title.partition(".")[0], self._guard.title
        raise Refused(f"{does} {title}, {why}{ONLY_SUMS.format(name)}", ScheduleError)


class Total:
    """An element or a slice of such a column, which knows only += and -=."""

    def __init__(self, column: Added, index: Any, value: Any, changed: bool = False) -> None:
        self.column, self.index, self.value, self.changed = column, index, value, changed

    def __iadd__(self, other: Any) -> "Total":
        return self._plus(other, 1)

    def __isub__(self, other: Any) -> "Total":
        return self._plus(other, -1)

    def _plus(self, other: Any, sign: int) -> "Total":
        if isinstance(other, Total):
            self.column.refuse("reads")
        if self.value.dtype.kind not in "iu" or cut(other):
            kind = self.value.dtype
            self.column.refuse("adds a float to", f"{kind}, and only sums of integers do not depend on the order, ")
        return Total(self.column, self.index, self.value + other if sign > 0 else self.value - other, True)

    def __getattr__(self, name: str) -> Any:
        return self._refuse()

    def _refuse(self, *_: Any) -> Any:
        self.column.refuse("reads or changes")


_OTHERS = {*dir(int), *dir(list)} - {*dir(object), "__iadd__"}
for _name in {name for name in _OTHERS if name.startswith("__")} | {f"__{name}__" for name in COMPARED}:
    setattr(Total, _name, Total._refuse)


def _wrong(layout: MemoryLayout, dim: int | str, tag: Tag) -> str:
    """What is wrong with an index of a dimension, and how to cure it; "" for nothing."""
    rows, size = layout.rows(*tag.components), layout.dims[dim] if isinstance(dim, str) else dim
    listed = f"Rows[{', '.join(component.__name__ for component in tag.components)}]"
    if tag.what == "size" or np.array_equal(rows, np.arange(len(rows))):  # an index is the row
        return ""
    if size == layout.dims["rows"]:
        wrong = tag.what == "index"
        return f"which is by row, with an index in {listed}: take the row, which {listed} has there" if wrong else ""
    if tag.what == "index":
        return ""
    has = f"which has {size} ('{dim}')" if isinstance(dim, str) else f"which has {size}"
    return f"{has}, with a row of {listed}: take an index in that list, as range(its size) or RowIndex has it"


def counted(*bounds: Any) -> Any:
    """Python's range, of Indexes if it counts up to a Size."""
    size = next((bound.tag for bound in bounds[:2] if getattr(bound, "tag", None) and bound.tag.what == "size"), None)
    numbers = range(*bounds)
    return [tagged(Index, k, "index", size.components) for k in numbers] if size else numbers


def numbered(values: Iterable[Any], start: int = 0) -> Iterable[tuple[Any, Any]]:
    """Python's enumerate, of Indexes for a list of rows."""
    whole = isinstance(values, Selection) and not start
    return zip(counted(values.size), values, strict=True) if whole else enumerate(values, start)  # type: ignore[attr-defined]


def length(values: Any) -> int:
    """Python's len, a Size for a list of rows."""
    found: int = values.size if isinstance(values, Selection) else len(values)
    return found
