"""A user's system that runs as Python on stand-ins for its arguments, which refuse undeclared use.

All values are those of plain arrays. Rows and indices are integers with a tag for their meaning: where agents have the
first rows, both are the same numbers, so a mechanic that confuses them works until another one adds entities before
them. Functions that the system calls run as copies of themselves: in these, `range`, `enumerate` and `len` know rows
and indices, and random numbers are recorded.
"""

import builtins
import functools
import re
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import CellType, FunctionType, ModuleType
from typing import Any

import numpy as np

from ..declarations.access import Parameter
from ..declarations.component import Component, Singleton
from ..declarations.fields import width
from ..declarations.system import System
from ..kernels import random
from ..kernels.errors import DeclarationError, EngineError, ScheduleError, did_you_mean, place
from ..kernels.frozen_values import LIBRARIES, codes, is_library
from ..memory.layout import MemoryLayout

Array = np.ndarray[Any, Any]
COMPARED = ("eq", "ne", "lt", "le", "gt", "ge", "array")
WRITERS = (np.copyto, np.fill_diagonal, np.place, np.put, np.putmask)  # write their first argument
Columns = set[tuple[type[Component], str]]
READ_ONLY = "which its parameter list declares as Read; declare it Write[{}]"
ONLY_SUMS = "but declares Add[{0}], which allows column[...] += integer and -= only; declare Write[{0}]"
SIZES = ("dtype", "itemsize", "nbytes", "ndim", "shape", "size", "strides")  # attributes that do not read elements
DRAWS = [getattr(random, name) for name in ("integer", "normal", "uniform", "uniform2", "words")]
SHARED = "which is read-only and the same for all worlds; take a Scratch or a column of a component"
CANNOT_BE = re.compile(r"\(\) (missing|takes|got) |item assignment|integer -?\d+ out of bounds|broadcast")  # of Python


class Refused(Exception):
    """A violation of a system's declarations, and its kind of error."""

    def __init__(self, text: str, kind: type[EngineError] = DeclarationError) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class Tag:
    """The meaning of an integer for the rows that have `components`: "row", "index" among them, or "size"."""

    what: str
    components: tuple[type[Component], ...]


class Row(np.int32):
    """An element of a list of rows, or of a RowIndex."""

    tag: Tag


class Index(int):
    """A Python integer with a tag for its meaning; numpy treats it as a plain one."""

    tag: Tag

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = (int(each) if isinstance(each, Index) else each for each in inputs)
        return getattr(function, method)(*plain, **options)


def tagged(kind: Any, value: Any, tag: Tag) -> Any:
    """Return a Row or an Index of that value."""
    made = kind(value)
    made.tag = tag
    return made


@dataclass
class Guard:
    """Permitted uses of an array."""

    title: str  # its name in errors
    system: "Traced"
    locked: str = ""  # reason why it is read-only
    dims: tuple[int | str, ...] = ()  # of its axes, as far as indices are checked
    gives: Tag | None = None  # the meaning of its elements
    computed: bool = True  # whether computing with it is allowed
    places: Array | None = None  # the last index of each of its elements, if some of these are not the system's own
    own: tuple[Array, str] | None = None  # whether these indices are the system's own, and their name in errors
    column: tuple[type[Component], str] | None = None  # that it is a part of

    def access(self, index: Any) -> None:
        """Refuse an index of the wrong kind."""
        if self.column:
            self.system.used.add(self.column)
        for dim, part in zip(self.dims, index if isinstance(index, tuple) else (index,), strict=False):
            if isinstance(part, slice):
                break
            if (tag := getattr(part, "tag", None)) and (wrong := self.system.misused(dim, tag)):
                raise Refused(f"indexes {self.title}, {wrong}")

    def write(self, dtype: np.dtype[Any], index: Any = ..., value: Any = None) -> None:
        """Refuse to write a value."""
        if self.locked:
            raise Refused(f"writes {self.title}, {self.locked}", ScheduleError)
        _guard(value).compute()
        if self.title and dtype.kind in "iu" and cut(value):
            raise Refused(f"writes a float to {self.title}, {dtype}, which cuts it off; say so, as in np.{dtype}(...)")
        self.access(index)
        if self.places is not None and self.own and not self.own[0][self.reach(self.places, index)].all():
            raise Refused(f"writes {self.title} beside {self.own[1]}; take an Offset for each field")
        if self.column:
            self.system.written.add(self.column)

    def reach(self, array: Any, index: Any) -> Any:
        """Return a part of an array. IndexError, with the title, for a part that does not exist."""
        try:
            return array[index]
        except IndexError as error:
            raise IndexError(f"{self.title}: {error}".removeprefix(": ")) from None

    def compute(self) -> None:
        """Refuse to compute with the array, where a system may take it for one number."""
        if not self.computed:
            raise Refused(
                f"computes with {self.title}, in which roles differ: write of({self.title}, e), where e is the row of "
                "the agent"
            )


FREE = Guard("", system=None)  # type: ignore[arg-type]  # of arrays that are the system's own


class Watched(np.ndarray):
    """An array with a guard. Results computed from it, and views from numpy's functions, are unguarded."""

    guard: Guard

    def __array_finalize__(self, source: Any) -> None:
        self.guard = FREE

    def __array_ufunc__(self, ufunc: Any, method: Any, *inputs: Any, out: Any = (), **options: Any) -> Any:
        for each in inputs:
            _guard(each).compute()
        for each in (each for each in out if each is not None):
            _guard(each).write(each.dtype)
        if out:
            options["out"] = tuple(map(_plain, out))
        result = getattr(ufunc, method)(*map(_plain, inputs), **options)
        return out[0] if len(out) == 1 else result

    def __array_function__(self, function: Any, kinds: Any, arguments: Any, options: Any) -> Any:
        if function in WRITERS:
            _guard(arguments[0]).write(arguments[0].dtype)
        return super().__array_function__(function, kinds, arguments, options)

    def __getitem__(self, index: Any) -> Any:
        plain, guard = _plain(self), self.guard
        guard.access(index)
        found = guard.reach(plain, index)
        if not isinstance(found, np.ndarray):
            return tagged(Row, found, guard.gives) if guard.gives and found >= 0 else found
        places = None if guard.places is None else guard.places[index]
        return watched(found, replace(guard, dims=(), places=places)) if np.may_share_memory(found, plain) else found

    def __setitem__(self, index: Any, value: Any) -> None:
        self.guard.write(self.dtype, index, value)
        self.guard.reach(_plain(self), index)
        _plain(self)[index] = value


def _guarded(name: str, writes: bool) -> Any:
    """Return a method of arrays that writes or computes with all elements."""

    def method(self: Watched, *arguments: Any, **options: Any) -> Any:
        if writes:
            self.guard.write(self.dtype)
        else:
            self.guard.compute()
        return getattr(_plain(self), name)(*arguments, **options)

    return method


for _name in ("fill", "partition", "put", "sort", "__bool__", "__float__", "__int__"):
    setattr(Watched, _name, _guarded(_name, writes=not _name.startswith("__")))


class Selection(Watched):
    """The list of a Rows parameter, whose size is tagged as that of the list."""

    @property
    def size(self) -> Any:
        """Its size."""
        gives = self.guard.gives
        return tagged(Index, len(self), Tag("size", gives.components)) if gives else len(self)

    @property  # type: ignore[misc]
    def shape(self) -> Any:
        """Its only dimension."""
        return (self.size,)


def watched(array: Array, guard: Guard, kind: type[Watched] = Watched) -> Any:
    """Return the same array with a guard."""
    view = array.view(kind)
    view.guard = guard
    return view


def _guard(value: Any) -> Guard:
    return value.guard if isinstance(value, Watched) else FREE


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, Watched) else value


def cut(value: Any) -> bool:
    """Return whether an integer column would cut off a written value.

    numpy turns an int and a uint64 into a float64, where machine code has an integer: an integral float is accepted.
    """
    if not isinstance(value, (float, np.floating, np.ndarray)):
        return False
    array = np.asarray(value)
    integral = type(value) is not float and array.dtype == np.float64 and bool((array == np.floor(array)).all())
    return array.dtype.kind == "f" and not integral


class Added:
    """A column that is declared Add: it only allows column[...] += integer, and -=."""

    def __init__(self, array: Array, guard: Guard) -> None:
        self._array, self._guard = array, guard

    def __getitem__(self, index: Any) -> "Total":
        self._guard.access(index)
        return Total(self, index, self._guard.reach(self._array, index))

    def __setitem__(self, index: Any, value: Any) -> None:
        same = isinstance(value, Total) and value.column is self and value.changed
        if not same or not (value.index is index or (isinstance(index, slice) and value.index == index)):
            self.refuse("writes")
        self._guard.write(self._array.dtype, index)
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
    """An element or a slice of such a column, which only allows += and -=."""

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
    """Return the fault in an index of a dimension, with the cure; "" if it is valid."""
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
    """Stand in for range, with Indexes if it counts up to a Size."""
    size = next((bound.tag for bound in bounds[:2] if getattr(bound, "tag", None) and bound.tag.what == "size"), None)
    numbers = range(*bounds)
    return [tagged(Index, k, Tag("index", size.components)) for k in numbers] if size else numbers


def numbered(values: Iterable[Any], start: int = 0) -> Iterable[tuple[Any, Any]]:
    """Stand in for enumerate, with Indexes for a list of rows."""
    selected = isinstance(values, Selection) and not start
    return zip(counted(values.size), values, strict=True) if selected else enumerate(values, start)  # type: ignore[attr-defined]


def length(values: Any) -> int:
    """Stand in for len, with a Size for a list of rows."""
    found: int = values.size if isinstance(values, Selection) else len(values)
    return found


PYTHON_ONLY: dict[str, Any] = {"range": counted, "enumerate": numbered, "len": length}


class Traced:
    """The function of a user's system, called like its kernel: raises EngineError for undeclared use.

    stand_in: names with another meaning in the system and in the functions that it calls; None: in these, all is
    as in Python, and changes of global variables last.
    """

    def __init__(self, system: System, layout: MemoryLayout, stand_ins: Mapping[str, Any] | None) -> None:
        self.system, self.layout = system, layout
        self.used, self.written = Columns(), Columns()  # its accesses so far
        self.misused = functools.cache(functools.partial(_wrong, layout))
        self.drawn = set[tuple[int, ...]]()
        function: Any = getattr(system.function, "py_func", system.function)
        self.codes = dict.fromkeys(codes(function.__code__), function)
        self._names = stand_ins or {}
        self._made: dict[Any, Any] = {each: each for each in self._names.values()}
        self._made |= {getattr(draw, "py_func", draw): self._drawing(draw) for draw in DRAWS}
        self.function = function if stand_ins is None else self._copy(function)
        self._own = _own_fields(system, layout)

    def __call__(self, *arguments: Any) -> None:
        """Run it in a world."""
        self.drawn.clear()
        given = [self._stand_in(*each) for each in zip(self.system.parameters, arguments, strict=True)]
        try:
            self.function(*given)
        except Refused as error:
            raise error.kind(f"{self._where(error)}{':' * (error.kind is DeclarationError)} {error}") from error
        except (NameError, AttributeError, OverflowError, TypeError, ValueError, IndexError) as error:
            self._explain(error)
            raise

    def _where(self, error: BaseException) -> str:
        """Return the system's label, with the lines of the calls that led to an error, outermost first."""
        steps = [(frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__)]
        lines = [place(self.codes[code], line) for code, line in steps if code in self.codes]
        return f"{self.system.label} ({'; '.join(lines)})"

    def _explain(self, error: Exception) -> None:
        """Raise an EngineError or an IndexError for an error that machine code would have, too."""
        owner, name, text = getattr(error, "obj", None), getattr(error, "name", None), str(error)
        table = next((c for c in self.layout.components if type(owner) is c.Table), None)
        known: Iterable[str] = ()
        if isinstance(error, IndexError):
            raise IndexError(f"{self._where(error)}: {text}") from error
        if isinstance(error, ValueError) and "read-only" in text:
            what = "writes an array that its parameter list declares as Read; declare it Write"
            raise ScheduleError(f"{self._where(error)} {what}") from error
        if isinstance(error, (OverflowError, TypeError, ValueError)) and not CANNOT_BE.search(text):
            return
        if table:
            text, known = f"{table.__name__} has no column '{name}'; it has: {', '.join(table.columns)}", table.columns
        elif isinstance(owner, ModuleType):
            known = dir(owner)
        elif type(error) is NameError:
            *_, (frame, _) = traceback.walk_tb(error.__traceback__)
            known = [*frame.f_locals, *frame.f_globals, *dir(builtins)]
        elif text == "can't set attribute":
            text = "a column cannot be replaced; write into it, as in column[...] = ..."
        raise DeclarationError(f"{self._where(error)}: {text}{did_you_mean(name, known, before='; ')}") from error

    # ---- arguments

    def _stand_in(self, parameter: Parameter, value: Any) -> Any:
        """Return the stand-in for an argument."""
        components, title = parameter.components, f"'{parameter.name}'"
        match parameter.kind:
            case "read" | "write" | "add" as access:
                columns = zip(components[0].columns, value, strict=True)
                return components[0].Table(*(self._column(components[0], access, *each) for each in columns))
            case "rows":
                return watched(value, Guard(title, self, SHARED, (len(value),), Tag("row", components)), Selection)
            case "row_index":
                return watched(value, Guard(title, self, SHARED, ("rows",), Tag("index", components)))
            case "bitset" | "numbers" if isinstance(value, np.ndarray):
                return watched(value, Guard(title, self, SHARED))
            case "number" if isinstance(value, np.ndarray) and value.ndim:
                return watched(value, Guard(parameter.name, self, SHARED, ("rows",), computed=False))
        return value

    def _column(self, component: type[Component], access: str, name: str, array: Any) -> Any:
        title, dims = f"{component.__name__}.{name}", component.columns[name].dims
        guard = Guard(
            title,
            self,
            READ_ONLY.format(component.__name__) if access == "read" else "",
            dims if issubclass(component, Singleton) else ("rows", *dims),
            column=(component, name),
        )
        if own := self._own.get((component, name)):
            guard.own, guard.places = own, np.broadcast_to(np.arange(array.shape[-1]), array.shape)
        return Added(array, guard) if access == "add" else watched(array, guard)

    # ---- functions that it calls

    def _copy(self, function: FunctionType) -> Any:
        """Return the function with stand-ins for its references."""
        if function not in self._made:
            cells = [CellType() for _ in function.__closure__ or ()]
            names: dict[str, Any] = {**function.__globals__, **self._names}
            copy = FunctionType(
                function.__code__, names, function.__name__, function.__defaults__, tuple(cells) or None
            )
            copy.__kwdefaults__ = function.__kwdefaults__
            self._made[function] = copy
            self.codes |= dict.fromkeys(codes(function.__code__), function)
            for name in {name for code in codes(function.__code__) for name in code.co_names}:
                if name in names:
                    names[name] = self._replaced(names[name])
            for cell, was in zip(cells, function.__closure__ or (), strict=True):
                try:
                    cell.cell_contents = self._replaced(was.cell_contents)
                except ValueError:  # it is empty so far
                    continue
        return self._made[function]

    def _replaced(self, value: Any) -> Any:
        """Return the stand-in for a value that a function refers to."""
        plain = getattr(value, "py_func", value)
        if isinstance(plain, FunctionType) and not is_library(plain):
            return self._copy(plain)
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] not in LIBRARIES:
            return _Names(value, self._replaced)
        return value

    def _drawing(self, draw: Any) -> Callable[..., Any]:
        """Return a function of kernels.random that refuses a draw that gives the number of an earlier one."""
        plain = getattr(draw, "py_func", draw)

        def stand_in(key: Any, index: Any, bound: Any = None) -> Any:
            numbers = {"index": index} | ({} if bound is None else {"bound": bound})
            for name, value in numbers.items():
                if isinstance(value, (float, np.floating)):
                    raise Refused(
                        f"draws with a float as {name}, which cuts it off; take an integer, as in int({name})"
                    )
            if numbers.get("bound", 1) < 1:
                raise Refused(f"draws an integer below {bound}: the bound is 1 or more")
            draw = (*map(int, key), int(index))
            if draw in self.drawn:
                raise Refused(
                    f"draws at an index at which it has drawn already ({index}): both are made of the same random "
                    "number; take another index for each, as in 2 * i and 2 * i + 1, or entities.identity[e]"
                )
            self.drawn.add(draw)
            return plain(key, *numbers.values())

        return stand_in


class _Names:
    """A module whose functions are replaced."""

    def __init__(self, module: ModuleType, replaced: Callable[[Any], Any]) -> None:
        self._module, self._replaced = module, replaced

    def __getattr__(self, name: str) -> Any:
        return self._replaced(getattr(self._module, name))


def _own_fields(system: System, layout: MemoryLayout) -> dict[tuple[type[Component], str], tuple[Array, str]]:
    """Return, by column of an observation with Offsets of a system, which columns are its own, and its Offsets.

    An Offset also stands for the fields after its own, if the system's mechanic adds these.
    """
    (module,) = (each for each in layout.modules if each.name == system.module)
    found = dict[tuple[type[Component], str], tuple[Array, str]]()
    for (component, name), offsets in system.offsets().items():
        key = component.columns[name].key or name
        there = layout.fields[key]
        own, added = np.zeros(width(there), bool), {field.name for field in module.fields().get(key, ())}
        previous = ""
        for field in there.values():  # in the order of their columns
            behind = {previous, field.name} <= added and own[field.start - 1]
            own[field.columns] = behind or f"{key}_{field.name}" in offsets
            previous = field.name
        found[component, name] = own, f"the fields of its Offsets ({', '.join(sorted(offsets))})"
    return found
